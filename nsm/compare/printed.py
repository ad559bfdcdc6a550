"""Volumes over time that the paper prints in its table 9, and whether they can be what they are called."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from nsm.cli.errors import InputError
from nsm.cli.settings import positive


class PrintedVolume(NamedTuple):
    """Figures of one method on one pair in table 9 of the paper.

    Attributes:
        variance: What the paper calls the variance of the volume over time.
        maximum: What it calls the maximal variation of the volume.
    """

    variance: float
    maximum: float


#: Printed figures by pair and method.
Printed = Mapping[str, Mapping[str, PrintedVolume]]


class Readings(NamedTuple):
    """Numbers of entries whose two figures contradict each other, by what the first one is taken for.

    Of values over time, neither the standard deviation nor the square root of the variance can be above the greatest
    deviation from one of them, but for the factor √(k / (k − 1)) of k times, which is neglected.

    Attributes:
        entries: Number of all entries.
        as_deviation: Contradictions if the figure is a standard deviation.
        as_variance: Contradictions if it is a variance.
    """

    entries: int
    as_deviation: int
    as_variance: int


def read_printed(given: Any) -> Printed:
    """Read the setting ``paper``: by pair and method, a list of the variance and the maximum.

    Raises:
        InputError: If an entry is not two positive numbers.
    """
    found: dict[str, dict[str, PrintedVolume]] = {}
    for pair, methods in dict(given or {}).items():
        for method, figures in dict(methods).items():
            if not isinstance(figures, list) or len(figures) != len(PrintedVolume._fields):
                raise InputError(
                    f"`paper.{pair}.{method}` must be a list of a variance and a maximum, got {figures}. "
                    f"Try `paper.{pair}.{method}=[0.01,0.02]`."
                )
            values = (positive(f"paper.{pair}.{method}", figure, 0.01) for figure in figures)
            found.setdefault(str(pair), {})[str(method)] = PrintedVolume(*values)
    return found


def readings(printed: Printed) -> Readings:
    """Count the entries that cannot be what they are called.

    >>> readings({"a_b": {"ours": PrintedVolume(0.04, 0.1), "theirs": PrintedVolume(0.04, 0.2)}})
    Readings(entries=2, as_deviation=0, as_variance=1)
    """
    entries = [entry for methods in printed.values() for entry in methods.values()]
    return Readings(
        len(entries),
        sum(entry.variance > entry.maximum for entry in entries),
        sum(math.sqrt(entry.variance) > entry.maximum for entry in entries),
    )
