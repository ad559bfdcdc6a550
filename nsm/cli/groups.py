"""Groups of choices and settings of a command, read from the text of its YAML file.

The comments of that file are the only description of a command: its head says what the command does and gives
examples (indented lines), and a comment behind each group or setting says what it chooses.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from nsm.cli.configuration import CONF

#: An entry of the defaults list with its comment; one that is commented out is a group to be added with a plus.
_GROUP = re.compile(r"^\s+(?P<off># )?- (?P<group>[\w/]+)(@(?P<package>\w+))?: *(?P<chosen>[\w]+)(\s+# (?P<says>.*))?$")
_SETTING = re.compile(r"^(?P<name>\w+):(?P<value>[^#]*?)(\s+# ?(?P<says>.*))?$")


@dataclass(frozen=True)
class Group:
    """A choice between the files of a folder.

    Attributes:
        folder: Folder in ``conf``.
        package: Part of the configuration that it fills, where that is not named after the folder.
        chosen: Default option, or an example for a group without one.
        says: What the group chooses.
        added: Whether it has no default and is added with a plus.
    """

    folder: str
    package: str | None
    chosen: str
    says: str
    added: bool

    @property
    def typed(self) -> str:
        """Left-hand side of the override that chooses an option."""
        return f"{'+' if self.added else ''}{self.folder}" + (f"@{self.package}" if self.package else "")

    @property
    def option_names(self) -> list[str]:
        """Names of all options."""
        return option_names(self.folder)


@dataclass(frozen=True)
class Setting:
    """A top-level value of the configuration, with its default as written in the file."""

    name: str
    default: str
    says: str


@dataclass(frozen=True)
class Description:
    """What the YAML file of a command says about it."""

    purpose: str
    examples: list[str]
    groups: list[Group]
    settings: list[Setting]


def option_names(folder: str) -> list[str]:
    """Names of the options in a folder of ``conf``; empty if there is no such folder."""
    return sorted(file.stem for file in (CONF / folder).glob("*.yaml"))


def group_folders() -> set[str]:
    """Names of all folders of ``conf``."""
    return {folder.name for folder in CONF.iterdir() if folder.is_dir() and folder.name != "hydra"}


def describe(config_name: str) -> Description:
    """Read the description of a command from ``conf/<config_name>.yaml``."""
    lines = Path(CONF / f"{config_name}.yaml").read_text().splitlines()
    head = [line[1:] for line in lines[: next(i for i, line in enumerate(lines) if not line.startswith("#"))]]
    purpose = " ".join(line.strip() for line in head if not line.startswith("   "))
    examples = [line.strip() for line in head if line.startswith("   ")]
    groups = [_group(match) for line in lines if (match := _GROUP.match(line))]
    return Description(purpose, examples, groups, _settings(lines))


def _group(match: re.Match[str]) -> Group:
    says = match["says"] or ""
    return Group(match["group"], match["package"], match["chosen"], says, match["off"] is not None)


def _settings(lines: list[str]) -> list[Setting]:
    found: list[Setting] = []
    continued = False
    for line in lines:
        match = _SETTING.match(line)
        if match and match["name"] not in ("defaults", "hydra"):
            found.append(Setting(match["name"], match["value"].strip(), (match["says"] or "").strip()))
            continued = True
        elif continued and line.strip().startswith("# ") and line.startswith(" "):
            last = found.pop()
            found.append(Setting(last.name, last.default, f"{last.says} {line.strip()[2:].strip()}".strip()))
        else:
            continued = False
    return found
