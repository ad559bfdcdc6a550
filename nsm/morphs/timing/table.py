"""Timing through given times."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from torch import Tensor

from nsm.cli.settings import invalid, numbers
from nsm.geometry.monotone import MonotoneCubic
from nsm.morphs.timing.base import Timing

#: A valid table, for messages: the motion rests in the middle.
_EXAMPLE = "[[0,0],[0.4,0.5],[0.6,0.5],[1,1]]"


class Table(Timing):
    """A motion that passes given times, smooth and monotone between them; equal values of t are a rest.

    Args:
        pairs: Pairs of a film time s and the time t of the morph, from (0, 0) to (1, 1), s increasing, t nondecreasing.

    Raises:
        InputError: If the pairs are none of that.

    Example:
        >>> pause = Table([[0, 0], [0.4, 0.5], [0.6, 0.5], [1, 1]])
        >>> pause(0.4), pause(0.53), pause.rate(0.5)
        (0.5, 0.5, 0.0)
    """

    def __init__(self, pairs: Sequence[Sequence[float]]) -> None:
        rows = [_pair(row, pairs) for row in pairs]
        rising = all(a[0] < b[0] and a[1] <= b[1] for a, b in pairwise(rows))
        if len(rows) < 2 or not rising or (rows[0], rows[-1]) != ((0.0, 0.0), (1.0, 1.0)):
            wanted = (
                "pairs of times from [0,0] to [1,1], the first of each pair increasing and the second not decreasing"
            )
            raise invalid("timing.pairs", wanted, pairs, _EXAMPLE)
        self._curve = MonotoneCubic([film for film, _ in rows], [time for _, time in rows])

    def position(self, s: Tensor) -> Tensor:
        # rounding of the polynomials must not leave [0, 1], nor miss its upper end
        return self._curve(s).clamp(0, 1).where(s < 1, s)

    def slope(self, s: Tensor) -> Tensor:
        return self._curve.derivative(s).clamp(min=0)


def _pair(row: Any, pairs: Any) -> tuple[float, float]:
    if not isinstance(row, list | tuple) or len(numbers("timing.pairs", list(row))) != 2:
        raise invalid("timing.pairs", "a list of pairs of times", pairs, _EXAMPLE)
    return float(row[0]), float(row[1])
