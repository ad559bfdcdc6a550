"""Timing that starts gently."""

from __future__ import annotations

from torch import Tensor

from nsm.morphs.timing.base import Eased


class EaseIn(Eased):
    """A motion that starts at rest, t = s^p.

    Args:
        power: Exponent p, at least 1; the greater, the longer the start.

    Raises:
        InputError: If ``power`` is less than 1 or not finite.

    Example:
        >>> EaseIn(2)(0.5), EaseIn(2).rate(1.0)
        (0.25, 2.0)
    """

    def position(self, s: Tensor) -> Tensor:
        return s**self.power

    def slope(self, s: Tensor) -> Tensor:
        return self.power * s ** (self.power - 1)
