"""The interface of timings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TypeVar

import torch
from scipy.optimize import brentq
from torch import Tensor

from nsm.cli.settings import invalid, number

#: One time, or n times of shape (n,), or either; functions of it return the same kind.
Time = TypeVar("Time", float, Tensor, float | Tensor)


class Timing(ABC):
    """A nondecreasing map from film time s to the time t of a morph, with t(0) = 0 and t(1) = 1 exactly.

    Beyond [0, 1] it goes on at the rate of the nearest end, so that differences in time can be taken at the ends.
    """

    @abstractmethod
    def position(self, s: Tensor) -> Tensor:
        """t at film times in [0, 1], of any shape."""

    @abstractmethod
    def slope(self, s: Tensor) -> Tensor:
        """dt/ds at film times in [0, 1], of any shape."""

    def __call__(self, s: Time) -> Time:
        """t at one film time, or at film times of shape (n,)."""
        if not isinstance(s, Tensor):
            return float(self(torch.tensor(s, dtype=torch.double)))
        inside = s.clamp(0, 1)
        return self.position(inside) + self.slope(inside) * (s - inside)

    def inverse(self, t: float) -> float:
        """A film time that shows the time t of the morph, found by bracketing; exact at 0 and 1."""
        if t in (0, 1):
            return float(t)
        return float(brentq(lambda s: self(s) - t, 0.0, 1.0, xtol=1e-15))

    def rate(self, s: Time) -> Time:
        """dt/ds ≥ 0, the factor by which velocities grow, at one film time or at film times of shape (n,)."""
        if not isinstance(s, Tensor):
            return float(self.rate(torch.tensor(s, dtype=torch.double)))
        return self.slope(s.clamp(0, 1))


class Eased(Timing):
    """A timing that a power shapes.

    Args:
        power: Exponent p, at least 1; the greater, the longer the motion is slow.

    Raises:
        InputError: If ``power`` is less than 1 or not finite.
    """

    def __init__(self, power: float = 2.0) -> None:
        self.power = number("timing.power", power, 2)
        if self.power < 1:
            raise invalid("timing.power", "a number of at least 1", power, 2)
