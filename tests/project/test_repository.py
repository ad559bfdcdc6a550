"""What holds the repository together: pinned versions, one configuration folder wherever installed, short files."""

from __future__ import annotations

import itertools
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from nsm.cli.configuration import CONF

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
MODULES = sorted((ROOT / "nsm").rglob("*.py"))
UNPINNED = {"ray"}  # needs an older cloudpickle than the other launchers
CONFIGS = sorted((ROOT / "conf").rglob("*.yaml"))


def requirements() -> list[Requirement]:
    project = PROJECT["project"]
    extras = [lines for extra, lines in project["optional-dependencies"].items() if extra not in UNPINNED]
    lines = itertools.chain(project["dependencies"], *extras)
    return [requirement for line in lines if (requirement := Requirement(line)).name != "nsm"]


def pinned() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pairs = [line.split("==") for line in lines if not line.startswith("#")]
    return {canonicalize_name(name): version for name, version in pairs}


@pytest.mark.parametrize("requirement", requirements(), ids=lambda r: r.name)
def test_every_requirement_is_pinned_within_its_range(requirement: Requirement) -> None:
    version = pinned().get(canonicalize_name(requirement.name))
    assert version, f"{requirement.name} is missing from constraints.txt"
    assert requirement.specifier.contains(version)


def test_pins_name_versions_and_no_places_or_builds() -> None:
    for line in (ROOT / "constraints.txt").read_text().splitlines():
        assert line.startswith("#") or re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.]+", line), line


def test_the_broken_releases_of_lightning_are_excluded() -> None:
    lightning = next(r for r in requirements() if r.name == "lightning")
    assert not any(lightning.specifier.contains(bad) for bad in ("2.4.0", "2.6.2", "2.6.3"))
    assert lightning.specifier.contains("2.6.1")


def test_style_is_checked_by_the_same_ruff_everywhere() -> None:
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())
    revisions = {repo["repo"].rsplit("/", 1)[-1]: repo["rev"] for repo in hooks["repos"]}
    assert revisions["ruff-pre-commit"] == f"v{pinned()['ruff']}"


def test_make_explains_each_of_its_targets() -> None:
    shown = subprocess.run(["make", "-s"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    targets = ["help", "demo", "test", "coverage", "nightly", "lint", "docs", "bench"]
    assert re.findall(r"^  make (\w+)\s+\w", shown, re.MULTILINE) == targets


def test_ci_is_executable_and_runs_what_people_run() -> None:
    script = ROOT / ".ci" / "run"
    assert script.stat().st_mode & 0o111
    assert {"make lint docs &", "make test", "wait $!"} <= set(script.read_text().splitlines())


def test_configuration_is_found_in_a_checkout() -> None:
    assert CONF == ROOT / "conf"
    assert (CONF / "train.yaml").is_file()


@pytest.mark.parametrize("path", CONFIGS, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_configuration_file_is_yaml(path: Path) -> None:
    assert isinstance(yaml.safe_load(path.read_text()), dict | None)


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_modules_stay_short_and_say_what_they_are(path: Path) -> None:
    text = path.read_text()
    assert len(text.splitlines()) <= 350, "split it: one concept a file"
    assert not text or text.startswith('"""')
    assert "TO" + "DO" not in text


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this checkout, built with the tools of the environment and no network."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    return next(folder.glob("nsm-*.whl"))


def test_the_wheel_carries_the_package_and_its_whole_configuration(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {f"nsm/{path.relative_to(ROOT).as_posix()}" for path in CONFIGS} <= names
    assert {path.relative_to(ROOT).as_posix() for path in MODULES} <= names
    assert not any(name.startswith(("tests/", "tools/", "conf/")) for name in names)


def test_an_installed_wheel_finds_its_configuration_inside_the_package(wheel: Path, tmp_path: Path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path)
    code = "import importlib.util as u; s = u.spec_from_file_location('c', 'nsm/cli/configuration.py'); "
    code += "m = u.module_from_spec(s); s.loader.exec_module(m); print(m.CONF)"
    shown = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert Path(shown.stdout.strip()) == tmp_path.resolve() / "nsm" / "conf"
    assert (tmp_path / "nsm" / "conf" / "train.yaml").is_file()
