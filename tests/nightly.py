"""How often tests try what has no end: a few times every day, and many times at night."""

from __future__ import annotations

import os

#: Whether every test makes all its tries, as in ``make nightly``, or a few of them, as in ``make test``.
NIGHTLY = os.environ.get("NSM_NIGHTLY") == "1"


def tries(few: int, many: int) -> int:
    """The number of tries in the tests of every day, and in the nightly run."""
    return many if NIGHTLY else few
