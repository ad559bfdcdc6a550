"""Overrides of settings, written in the grammar of the command line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

#: Texts that mean themselves without quotes, as long as they are not read as a number or a constant.
_PLAIN = re.compile(r"[\w/.+$%*@?|-]+", re.ASCII)
_CONSTANTS = {"null", "true", "false", "inf", "nan"}
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
    return [f"shape@{side}=file", f"{side}.path={literal(path)}"]


def literal(value: Any) -> str:
    """Write a value in the grammar of Hydra's overrides, a text in quotes where it needs them.

    >>> literal("a.obj"), literal("a=b.obj"), literal("1"), literal([0.5, None, True])
    ('a.obj', "'a=b.obj'", "'1'", '[0.5,null,true]')
    """
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, list | tuple):
        return f"[{','.join(map(literal, value))}]"
    if not isinstance(value, str) or _means_itself(value):
        return str(value)
    # only a quote, and backslashes before a quote, are escaped
    return "'" + re.sub(r"(\\*)('|$)", lambda end: 2 * end[1] + ("\\'" if end[2] else ""), value) + "'"


def _means_itself(text: str) -> bool:
    if not _PLAIN.fullmatch(text) or text.lstrip("+-").lower() in _CONSTANTS:
        return False
    try:
        float(text)
    except ValueError:
        return True
    return False
