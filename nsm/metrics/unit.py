"""Units of figures of merit, and how many digits a table shows of them."""

from __future__ import annotations

import math
from typing import NamedTuple

#: Shown in place of a value that is not defined.
MISSING = "–"
#: Magnitudes from the first up to the second are shown without an exponent.
_PLAIN = (1e-4, 1e4)


class Unit(NamedTuple):
    """A unit of measurement, with the precision at which values in it are shown.

    Attributes:
        name: Name of the unit, such as ``length/time``; empty for a plain number.
        decimals: Digits after the decimal point; None to show ``significant`` digits.
        significant: Significant digits where ``decimals`` is None.
        symbol: Symbol written directly behind a value, such as ``°``.
    """

    name: str
    decimals: int | None = None
    significant: int = 3
    symbol: str = ""

    def format(self, value: float) -> str:
        """The value as text, without the symbol of the unit.

        >>> LENGTH.format(0.01234), LENGTH.format(1.234e-5), COUNT.format(2.0), DEGREE.format(3.21)
        ('0.0123', '1.23e-05', '2', '3.2')
        """
        if not math.isfinite(value):
            return MISSING
        if self.decimals is not None:
            return f"{value:.{self.decimals}f}"
        if value == 0 or _PLAIN[0] <= abs(value) < _PLAIN[1]:
            return f"{value:#.{self.significant}g}".rstrip(".")
        return f"{value:.{self.significant - 1}e}"


#: Lengths and times are those of the morph's box and of t unless the name says otherwise.
NUMBER = Unit("")
RELATIVE = Unit("relative")
PER_MILLE = Unit("per mille", symbol=" ‰")
RATIO = Unit("ratio")
COUNT = Unit("count", decimals=0)
DEGREE = Unit("degree", decimals=1, symbol="°")
LENGTH = Unit("length")
SPEED = Unit("length/time")
RATE = Unit("1/time")
AREA = Unit("length^(d-1)")
FILE_VOLUME = Unit("file length^d", significant=5)
