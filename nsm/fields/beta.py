"""Functions β that switch the gradient part of an adaptive-divergence field off on the surface (paper, section 5.1).

Every β is smooth, even, non-negative, and has β(0) = β'(0) = 0: that is all theorem 1 asks for.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from math import inf

import torch
from torch import Tensor, nn

from nsm.cli.errors import InputError


class Beta(nn.Module, ABC):
    """A function β of the signed distance s, of any shape, with its derivative."""

    @abstractmethod
    def forward(self, s: Tensor) -> Tensor:
        """β(s)."""

    @abstractmethod
    def derivative(self, s: Tensor) -> Tensor:
        """β'(s)."""


class Gaussian(Beta):
    """β(s) = 1 − exp(−α s²), the paper's choice with α = 0.1; it tends to 1 far away.

    Args:
        alpha: how fast β grows, in 1/length².
    """

    def __init__(self, alpha: float = 0.1) -> None:
        super().__init__()
        self.alpha = _positive("alpha", alpha)

    def forward(self, s: Tensor) -> Tensor:
        return -torch.expm1(-self.alpha * s.square())

    def derivative(self, s: Tensor) -> Tensor:
        return 2 * self.alpha * s * torch.exp(-self.alpha * s.square())


class Rational(Beta):
    """β(s) = s² / (s² + w²): quadratic near the surface, tending to 1 slowly, with no exponential.

    Args:
        width: the distance w at which β is one half.
    """

    def __init__(self, width: float = 1.0) -> None:
        super().__init__()
        self.width = _positive("width", width)

    def forward(self, s: Tensor) -> Tensor:
        return s.square() / (s.square() + self.width**2)

    def derivative(self, s: Tensor) -> Tensor:
        return 2 * s * self.width**2 / (s.square() + self.width**2).square()


class Quartic(Beta):
    """β(s) = s⁴ / (s⁴ + w⁴): flatter on the surface, where also β'' = 0 and the field stays free of divergence longer.

    Args:
        width: the distance w at which β is one half.
    """

    def __init__(self, width: float = 1.0) -> None:
        super().__init__()
        self.width = _positive("width", width)

    def forward(self, s: Tensor) -> Tensor:
        return s.pow(4) / (s.pow(4) + self.width**4)

    def derivative(self, s: Tensor) -> Tensor:
        return 4 * s.pow(3) * self.width**4 / (s.pow(4) + self.width**4).square()


class Quadratic(Beta):
    """β(s) = (s/w)²: the leading term of the paper's β, without the bound by 1.

    Args:
        width: the distance w at which β is one.
    """

    def __init__(self, width: float = 3.1622776601683795) -> None:
        super().__init__()
        self.width = _positive("width", width)

    def forward(self, s: Tensor) -> Tensor:
        return (s / self.width).square()

    def derivative(self, s: Tensor) -> Tensor:
        return 2 * s / self.width**2


def _positive(name: str, value: float) -> float:
    if not 0 < value < inf:
        raise InputError(f"beta.{name}={value} makes no β that vanishes at 0 alone: give a finite number above 0")
    return float(value)
