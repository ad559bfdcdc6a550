"""The form of all error messages: "`name` must be …, got …. Try `…`.", as `conftest.py` checks it in every test."""

from __future__ import annotations

import re

#: Rooms and modules with messages that do not have the form yet.
UNCONVERTED = (
    "nsm.compare",
    "nsm.io.checkpoint",
    "nsm.io.shape_file",
    "nsm.library",
    "nsm.morphs.advected",
    "nsm.morphs.optimal_transport.density",
    "nsm.morphs.surfaces",
    "nsm.plots",
)
#: Something named, what is required of it, and what to do instead.
_PARTS = (re.compile(r"`[^`]+`"), re.compile(r"\b(must|cannot|needs)\b"), re.compile(r"\. Try .+[.?)]$", re.DOTALL))


def has_form(message: str) -> bool:
    """Whether a message names a setting, file, or object, says what it must be, and what to try instead."""
    return all(part.search(message) for part in _PARTS)


def is_checked(module: str) -> bool:
    """Whether the messages of a module must have the form."""
    return module.startswith("nsm.") and not module.startswith(UNCONVERTED)
