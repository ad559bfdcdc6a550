"""Statistics over times that leave out the times at which a figure is not defined."""

from __future__ import annotations

import math
from collections.abc import Iterable


def mean(values: Iterable[float]) -> float:
    """Mean of the values that are not nan; nan where none is left.

    >>> mean([1.0, math.nan, 2.0])
    1.5
    """
    defined = _defined(values)
    return math.fsum(defined) / len(defined) if defined else math.nan


def least(values: Iterable[float]) -> float:
    """Least of the values that are not nan; nan where none is left."""
    return min(_defined(values), default=math.nan)


def greatest(values: Iterable[float]) -> float:
    """Greatest of the values that are not nan; nan where none is left."""
    return max(_defined(values), default=math.nan)


def _defined(values: Iterable[float]) -> list[float]:
    return [value for value in values if not math.isnan(value)]
