"""How evenly a motion is spread over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Motion(NamedTuple):
    """Mean speed of a surface along its normal at some times, in lengths per unit of time; linear in between.

    Attributes:
        times: increasing, at least two.
        speeds: as many.
    """

    times: Sequence[float]
    speeds: Sequence[float]

    @property
    def distance(self) -> float:
        """How far the surface moves in all, ∫ speed dt."""
        return self.distance_between(self.times[0], self.times[-1])

    @property
    def unevenness(self) -> float:
        """Greatest speed over the mean of it: 1 for a motion of constant speed; not a number where nothing moves."""
        mean = self.distance / (self.times[-1] - self.times[0])
        return max(self.speeds) / mean if mean > 0 else float("nan")

    @property
    def middle_share(self) -> float:
        """Part of the motion that happens in the middle half of the time: ½ for a motion of constant speed."""
        quarter = (self.times[-1] - self.times[0]) / 4
        middle = self.distance_between(self.times[0] + quarter, self.times[-1] - quarter)
        return middle / self.distance if self.distance > 0 else float("nan")

    def distance_between(self, start: float, end: float) -> float:
        """∫ speed dt from one time to another."""
        inner = [t for t in self.times if start < t < end]
        moments = [start, *inner, end]
        return float(np.trapezoid(np.interp(moments, self.times, self.speeds), moments))
