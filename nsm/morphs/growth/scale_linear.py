"""Growth by size."""

from __future__ import annotations

from nsm.morphs.growth.base import BetweenEnds, Time


class ScaleLinear(BetweenEnds):
    """Size that changes at a constant rate: α = (1 − t) v_0^(1/d) + t v_1^(1/d).

    Example:
        >>> ScaleLinear(2, source=1.0, target=4.0).scale(0.5)
        1.5
    """

    def scale(self, t: Time) -> Time:
        return self.source ** (1 / self.dim) + self.rate(t) * t

    def rate(self, t: Time) -> Time:
        return self.target ** (1 / self.dim) - self.source ** (1 / self.dim) + 0 * t

    def relative_volume(self, t: Time) -> Time:
        return self.scale(t) ** self.dim

    def relative_rate(self, t: Time) -> Time:
        return self.dim * self.scale(t) ** (self.dim - 1) * self.rate(t)
