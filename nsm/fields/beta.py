"""Functions β that suppress the gradient part of an adaptive-divergence velocity on the surface (paper, section 5.1).

Every β is smooth, even, and non-negative with β(0) = β'(0) = 0, which is what theorem 1 requires.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm.cli.settings import positive


class Beta(nn.Module, ABC):
    """A function β of the signed distance, together with its derivative."""

    @abstractmethod
    def forward(self, s: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
        """Evaluate β at signed distances of any shape."""

    @abstractmethod
    def derivative(self, s: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
        """Evaluate β' at signed distances of any shape."""


class Gaussian(Beta):
    """β(s) = 1 − exp(−α s²): the paper's choice, with α = 0.1, which tends to 1 far from the surface.

    Args:
        alpha: Rate α, in 1/length².

    Raises:
        InputError: If ``alpha`` is not positive and finite.

    Example:
        >>> import torch
        >>> from nsm.fields import Gaussian
        >>> beta = Gaussian(alpha=0.1)
        >>> beta(torch.tensor([0.0, 1.0, 100.0]))
        tensor([0.0000, 0.0952, 1.0000])
    """

    def __init__(self, alpha: float = 0.1) -> None:
        super().__init__()
        self.alpha = positive("beta.alpha", alpha, example=0.1)

    def forward(self, s: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
        return -torch.expm1(-self.alpha * s.square())

    def derivative(self, s: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
        return 2 * self.alpha * s * torch.exp(-self.alpha * s.square())


class _Saturating(Beta):
    """β(s) = s^k / (s^k + w^k) for an even exponent k.

    Args:
        width: Distance w at which β = ½.

    Raises:
        InputError: If ``width`` is not positive and finite.
    """

    exponent: int

    def __init__(self, width: float = 1.0) -> None:
        super().__init__()
        self.width = positive("beta.width", width)

    def forward(self, s: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
        k = self.exponent
        return s.pow(k) / (s.pow(k) + self.width**k)

    def derivative(self, s: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
        k = self.exponent
        return k * s.pow(k - 1) * self.width**k / (s.pow(k) + self.width**k).square()


class Rational(_Saturating):
    """β(s) = s² / (s² + w²): quadratic near the surface, and tends to 1 more slowly than `Gaussian`.

    Args:
        width: Distance w at which β = ½.

    Example:
        >>> import torch
        >>> from nsm.fields import Rational
        >>> Rational(width=2.0)(torch.tensor([0.0, 2.0]))
        tensor([0.0000, 0.5000])
    """

    exponent = 2


class Quartic(_Saturating):
    """β(s) = s⁴ / (s⁴ + w⁴): also β''(0) = 0, so V is nearly divergence-free in a wider neighborhood.

    Args:
        width: Distance w at which β = ½.

    Example:
        >>> import torch
        >>> from nsm.fields import Quartic
        >>> Quartic(width=2.0)(torch.tensor([0.0, 1.0, 2.0]))
        tensor([0.0000, 0.0588, 0.5000])
    """

    exponent = 4


class Quadratic(Beta):
    """β(s) = (s/w)²: the leading term of the paper's β, which is not bounded by 1.

    Args:
        width: Distance w at which β = 1. The default, √10, matches `Gaussian` with α = 0.1 near the surface.

    Raises:
        InputError: If ``width`` is not positive and finite.

    Example:
        >>> import torch
        >>> from nsm.fields import Quadratic
        >>> Quadratic(width=2.0)(torch.tensor([0.0, 2.0]))
        tensor([0., 1.])
    """

    def __init__(self, width: float = 10**0.5) -> None:
        super().__init__()
        self.width = positive("beta.width", width)

    def forward(self, s: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
        return (s / self.width).square()

    def derivative(self, s: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
        return 2 * s / self.width**2
