"""The software bill of materials lists what is pinned, and advisories are compared with it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(ROOT / "tools")

    def load(name: str) -> ModuleType:
        return __import__(name)

    return load


def test_the_bill_lists_exactly_the_pins(tool) -> None:
    bill = json.loads((ROOT / "sbom.cdx.json").read_text())
    lines = (line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#"))
    pinned = {
        re.sub("[-_.]+", "-", name).lower(): version for name, _, version in (line.partition("==") for line in lines)
    }
    assert {part["name"]: part["version"] for part in bill["components"]} == pinned
    assert [part["purl"] for part in bill["components"]] == [f"pkg:pypi/{n}@{v}" for n, v in sorted(pinned.items())]
    assert (
        {"pkg:pypi/torch@" + pinned["torch"], "pkg:pypi/wandb@" + pinned["wandb"]}
        <= set(bill["dependencies"][0]["dependsOn"])
        <= {part["bom-ref"] for part in bill["components"]}
    )
    written = tool("bill_of_materials").bill_of_materials()
    assert (ROOT / "sbom.cdx.json").read_text() == written, "run: python tools/bill_of_materials.py"


def advisory(name: str, *events: dict[str, str], **more: object) -> dict[str, object]:
    affected = {"package": {"ecosystem": "PyPI", "name": name}, "ranges": [{"type": "ECOSYSTEM", "events": [*events]}]}
    return {"id": f"GHSA-{name}", "summary": "It breaks.", "affected": [affected], **more}


def checked(archive: Path | None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "tools" / "known_vulnerabilities.py")]
    environment = {"PYTHONPATH": str(ROOT), **({"NSM_ADVISORIES": str(archive)} if archive else {})}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def archived(file: Path, *advisories: dict[str, object]) -> Path:
    with zipfile.ZipFile(file, "w") as archive:
        for content in advisories:
            archive.writestr(f"{content['id']}.json", json.dumps(content))
    return file


def test_advisories_that_apply_are_listed_and_others_are_not(tmp_path: Path) -> None:
    applies = archived(
        tmp_path / "all.zip",
        advisory("Torch", {"introduced": "0"}, {"fixed": "99"}, aliases=["CVE-1"]),
        advisory("wandb", {"introduced": "0"}, {"fixed": "0.1"}),
        advisory("numpy", {"introduced": "0"}, withdrawn="2020-01-01T00:00:00Z"),
        advisory("not-pinned-here", {"introduced": "0"}),
    )
    found = checked(applies)
    assert found.returncode == 1
    first, last = found.stdout.splitlines()
    assert first.startswith("torch 2.")
    assert first.endswith("GHSA-Torch, CVE-1, fixed in 99. It breaks.")
    assert last.startswith("1 known vulnerabilities in the 2")
    clean = checked(archived(tmp_path / "none.zip", advisory("wandb", {"introduced": "0"}, {"last_affected": "0.1"})))
    assert (clean.returncode, clean.stdout.split()[0]) == (0, "0")


def test_without_advisories_the_check_says_that_it_was_skipped() -> None:
    skipped = checked(None)
    assert skipped.returncode == 0
    assert skipped.stdout.startswith("Skipped the check for known vulnerabilities: NSM_ADVISORIES names no archive")


@pytest.mark.parametrize(
    ("version", "inside"),
    [("0.9", False), ("1.0", True), ("1.4", True), ("1.5", False), ("2.0rc1", False), ("2.3", True)],
)
def test_ranges_begin_and_end_where_advisories_say(version: str, inside: bool, tool) -> None:
    events = [{"introduced": "2.0"}, {"last_affected": "2.3"}, {"introduced": "1.0"}, {"fixed": "1.5"}]
    ranges = {"ranges": [{"type": "ECOSYSTEM", "events": events}, {"type": "GIT", "events": [{"introduced": "0"}]}]}
    assert tool("known_vulnerabilities").applies(ranges, version) == inside
    assert tool("known_vulnerabilities").applies({"versions": ["1.0.0"]}, version) == (version == "1.0")
