"""Growth by volume."""

from __future__ import annotations

from nsm.morphs.growth.base import BetweenEnds, Time


class VolumeLinear(BetweenEnds):
    """Volume that changes at a constant rate: α^d = (1 − t) v_0 + t v_1.

    Example:
        >>> VolumeLinear(3, source=1.0, target=2.0).relative_volume(0.5)
        1.5
    """

    def relative_volume(self, t: Time) -> Time:
        return self.source + (self.target - self.source) * t

    def relative_rate(self, t: Time) -> Time:
        return self.target - self.source + 0 * t
