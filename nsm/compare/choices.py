"""Pairs and methods of a study, as its configuration lists them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.cli.settings import choice, invalid, nearest

#: Valid name of a pair or method; folders and files are named after it.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*")
#: Name of the row of the authors' morphs.
OFFICIAL = "official"
#: Figure of validation by which training chooses its best checkpoint.
ERROR = "val/error"
#: Figures of validation that are read from the log of a run.
VALIDATED = (ERROR, "val/distance", "val/volume_max")


class Choice(NamedTuple):
    """A pair or a method of a study.

    Attributes:
        name: Name of its column or row, and of its folder.
        file: Name of its file in ``conf/experiment`` or ``conf/method``.
        overrides: Further overrides of ``python -m nsm.train``.
        growth: Name of a file in ``conf/growth``, the change of volume with which a method's morph is evaluated.
    """

    name: str
    file: str
    overrides: tuple[str, ...]
    growth: str = "none"


def read_choices(key: str, group: str, entries: Sequence[Any], further: Sequence[str] = ()) -> tuple[Choice, ...]:
    """Read the entries of a list.

    Args:
        key: Name of the list, ``pairs`` or ``methods``.
        group: Folder of ``conf`` whose files the entries name.
        entries: Names, or mappings with the keys ``name``, ``group``, ``overrides``, and those of ``further``.
        further: Keys that only this list has.

    Raises:
        InputError: If an entry is not valid, two have one name, or there are none.
    """
    found = tuple(_choice(key, group, entry, further) for entry in entries or ())
    names = [choice.name for choice in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        first = twice[0]
        other = f"[{first},{{name: {first}_2, {group}: {first}}}]"
        raise invalid(key, "a list of entries with different names", f"{', '.join(twice)} twice", other)
    if not found:
        studies = " or ".join(f"`+study={study}`" for study in known("study"))
        raise InputError(f"`{key}` must be a list of some of {', '.join(known(group))}, got []. Try {studies}.")
    return found


def known(group: str) -> list[str]:
    """Names of the files of a folder of ``conf``."""
    return sorted(file.stem for file in (CONF / group).glob("*.yaml"))


def _choice(key: str, group: str, entry: Any, further: Sequence[str]) -> Choice:
    """Read an entry; a name alone stands for the file of that name."""
    given = {"name": entry} if isinstance(entry, str) else dict(entry)
    name = str(given.get("name") or given.get(group, ""))
    file = str(given.get(group, name))
    files = known(group)
    example = nearest(file, files) or files[0]
    keys = ("name", group, "overrides", *further)
    if unknown := set(given) - set(keys):
        requirement = f"a list of entries with the keys {', '.join(keys[:-1])}, and {keys[-1]} only"
        raise invalid(key, requirement, ", ".join(sorted(unknown)), f"[{{name: own, {group}: {example}}}]")
    if file not in files:
        raise invalid(key, f"a list of some of {', '.join(files)}", file, f"[{example}]")
    if not _NAME.fullmatch(name) or name == OFFICIAL:
        names = f"a list of entries whose names have letters, digits, and _ only and differ from {OFFICIAL}"
        raise invalid(key, names, name, f"[{{name: own, {group}: {example}}}]")
    growth = choice(f"{key}.growth", given.get("growth", "none"), known("growth"))
    return Choice(name, file, tuple(given.get("overrides") or ()), growth)
