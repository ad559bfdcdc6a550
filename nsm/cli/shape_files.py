"""Overrides that choose a shape from a file."""

from __future__ import annotations

import re
from pathlib import Path

_SUFFIX = re.compile(r"\.[A-Za-z]\w{1,5}$")


def names_file(text: str) -> bool:
    """Whether a text names a file, by its suffix or because there is one.

    >>> names_file("a.obj"), names_file("mesh"), names_file("0.5")
    (True, False, False)
    """
    return bool(_SUFFIX.search(text)) or Path(text).exists()


def shape_overrides(side: str, path: str) -> list[str]:
    """Overrides that choose the file ``path`` as ``source`` or ``target``.

    >>> shape_overrides("source", "a.obj")
    ['shape@source=file', 'source.path=a.obj']
    """
    return [f"shape@{side}=file", f"{side}.path={quoted(path)}"]


def quoted(value: str) -> str:
    """Write a text as a value of an override, in quotes where Hydra's grammar needs them.

    >>> quoted("a.obj"), quoted("a=b.obj")
    ('a.obj', "'a=b.obj'")
    """
    if value and all(character.isalnum() or character in "/-+.$%*@?|_" for character in value):
        return value
    escaped = value.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"
