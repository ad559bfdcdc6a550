"""Growth that starts and stops gently."""

from __future__ import annotations

from nsm.morphs.growth.base import BetweenEnds, Time


class SmoothStep(BetweenEnds):
    """Volume whose rate of change vanishes at both ends: α^d = v_0 + (v_1 − v_0) (3t² − 2t³).

    Example:
        >>> SmoothStep(3, source=1.0, target=2.0).relative_rate(1.0)
        0.0
    """

    def relative_volume(self, t: Time) -> Time:
        return self.source + (self.target - self.source) * t * t * (3 - 2 * t)

    def relative_rate(self, t: Time) -> Time:
        return (self.target - self.source) * 6 * t * (1 - t)
