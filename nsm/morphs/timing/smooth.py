"""Timing that starts and stops gently."""

from __future__ import annotations

from torch import Tensor

from nsm.morphs.timing.base import Timing


class Smooth(Timing):
    """A motion at rest at both ends, t = 3s² − 2s³ (smoothstep).

    Example:
        >>> Smooth()(0.25), Smooth().rate(0.5)
        (0.15625, 1.5)
    """

    def position(self, s: Tensor) -> Tensor:
        return s * s * (3 - 2 * s)

    def slope(self, s: Tensor) -> Tensor:
        return 6 * s * (1 - s)
