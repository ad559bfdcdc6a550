"""List the known vulnerabilities of the versions in constraints.txt, from a file of advisories and without a network.

    curl -O https://osv-vulnerabilities.storage.googleapis.com/PyPI/all.zip
    NSM_ADVISORIES=all.zip python tools/known_vulnerabilities.py

NSM_ADVISORIES names the archive of all advisories on PyPI that osv.dev publishes every day. Without it, the check is
skipped, which is said. The exit status is 1 if an advisory applies.

References:
    Open Source Vulnerability format, https://ossf.github.io/osv-schema/
"""

from __future__ import annotations

import json
import os
import sys
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from bill_of_materials import pins
from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion, Version


def main() -> None:
    """Print the advisories that apply, or that the check was skipped."""
    archive = os.environ.get("NSM_ADVISORIES")
    if not archive:
        print("Skipped the check for known vulnerabilities: NSM_ADVISORIES names no archive of osv.dev.")
        return
    pinned = pins()
    found = sorted(line for advisory in advisories(Path(archive)) for line in described(advisory, pinned))
    print("\n".join(found))
    print(f"{len(found)} known vulnerabilities in the {len(pinned)} packages of constraints.txt, by {archive}")
    if found:
        sys.exit(1)


def advisories(archive: Path) -> Iterator[dict[str, Any]]:
    """Read all advisories of an archive."""
    with zipfile.ZipFile(archive) as files:
        for name in files.namelist():
            if name.endswith(".json"):
                yield json.loads(files.read(name))


def described(advisory: Mapping[str, Any], pinned: Mapping[str, str]) -> Iterator[str]:
    """Describe each package to which an advisory applies in a line."""
    if "withdrawn" in advisory:
        return
    for affected in advisory.get("affected", ()):
        package = affected.get("package", {})
        name = canonicalize_name(package.get("name", ""))
        if package.get("ecosystem") != "PyPI" or name not in pinned or not applies(affected, pinned[name]):
            continue
        names = ", ".join([advisory["id"], *advisory.get("aliases", ())])
        fixed = [event["fixed"] for part in affected.get("ranges", ()) for event in part["events"] if "fixed" in event]
        advice = f"fixed in {', '.join(fixed)}" if fixed else "not fixed"
        yield f"{name} {pinned[name]}: {names}, {advice}. {advisory.get('summary', '')}".rstrip()


def applies(affected: Mapping[str, Any], version: str) -> bool:
    """Whether a version is among those that an advisory lists, or in one of its ranges.

    >>> ranges = [{"type": "ECOSYSTEM", "events": [{"introduced": "0"}, {"fixed": "2.1"}]}]
    >>> applies({"ranges": ranges}, "2.0"), applies({"ranges": ranges}, "2.1")
    (True, False)
    """
    if any(_parsed(listed) == Version(version) for listed in affected.get("versions", ())):
        return True
    ranges = (part["events"] for part in affected.get("ranges", ()) if part["type"] == "ECOSYSTEM")
    return any(_within(events, Version(version)) for events in ranges)


def _within(events: list[dict[str, str]], version: Version) -> bool:
    """Whether the last event up to a version is its introduction and not its end."""
    inside = False
    for kind, at in sorted((pair for event in events for pair in event.items()), key=lambda pair: _parsed(pair[1])):
        if kind == "introduced" and version >= _parsed(at):
            inside = True
        elif (kind == "fixed" and version >= _parsed(at)) or (kind == "last_affected" and version > _parsed(at)):
            inside = False
    return inside


def _parsed(version: str) -> Version:
    """Read a version; one that is none by PEP 440, which old advisories hold, counts as the first."""
    try:
        return Version(version)
    except InvalidVersion:
        return Version("0")


if __name__ == "__main__":
    main()
