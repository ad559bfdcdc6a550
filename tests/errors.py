"""The form of all error messages: "`name` must be …, got …. Try `…`.", as `conftest.py` checks it in every test."""

from __future__ import annotations

import re

#: Something named, what is required of it, and what to do instead.
_PARTS = (re.compile(r"`[^`]+`"), re.compile(r"\b(must|cannot|needs)\b"), re.compile(r"\. Try .+[.?)]$", re.DOTALL))


def has_form(message: str) -> bool:
    """Whether a message names a setting, file, or object, says what it must be, and what to try instead."""
    return all(part.search(message) for part in _PARTS)
