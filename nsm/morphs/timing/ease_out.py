"""Timing that stops gently."""

from __future__ import annotations

from torch import Tensor

from nsm.morphs.timing.base import Eased


class EaseOut(Eased):
    """A motion that comes to rest, t = 1 − (1 − s)^p.

    Args:
        power: Exponent p, at least 1; the greater, the longer the end.

    Raises:
        InputError: If ``power`` is less than 1 or not finite.

    Example:
        >>> EaseOut(2)(0.5), EaseOut(2).rate(1.0)
        (0.75, 0.0)
    """

    def position(self, s: Tensor) -> Tensor:
        return 1 - (1 - s) ** self.power

    def slope(self, s: Tensor) -> Tensor:
        return self.power * (1 - s) ** (self.power - 1)
