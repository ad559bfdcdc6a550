"""Evenness of a motion over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Motion(NamedTuple):
    """Mean speed of a surface along its normal over time, interpolated linearly.

    Attributes:
        times: Increasing times, at least two.
        speeds: Speed at each time, in lengths per unit of time.
    """

    times: Sequence[float]
    speeds: Sequence[float]

    @property
    def distance(self) -> float:
        """Distance that the surface moves in all, ∫ speed dt."""
        return self.distance_between(self.times[0], self.times[-1])

    @property
    def unevenness(self) -> float:
        """Greatest over mean speed: 1 for a motion of constant speed, nan for none."""
        mean = self.distance / (self.times[-1] - self.times[0])
        return max(self.speeds) / mean if mean > 0 else float("nan")

    @property
    def middle_share(self) -> float:
        """Part of the motion that happens in the middle half of the time: ½ for a motion of constant speed."""
        quarter = (self.times[-1] - self.times[0]) / 4
        middle = self.distance_between(self.times[0] + quarter, self.times[-1] - quarter)
        return middle / self.distance if self.distance > 0 else float("nan")

    def distance_between(self, start: float, end: float) -> float:
        """Distance that the surface moves between two times, ∫ speed dt."""
        inner = [t for t in self.times if start < t < end]
        nodes = [start, *inner, end]
        return float(np.trapezoid(np.interp(nodes, self.times, self.speeds), nodes))
