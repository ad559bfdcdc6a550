"""Interpolation that neither overshoots nor turns back between given values."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from torch import Tensor


class MonotoneCubic:
    """A piecewise cubic with a continuous derivative through given values, monotone between neighbors (PCHIP).

    Args:
        knots: Increasing arguments, at least two.
        values: A value at each.

    References:
        F. N. Fritsch and J. Butland, A method for constructing local monotone piecewise cubic interpolants,
        SIAM Journal on Scientific and Statistical Computing 5, 1984, https://doi.org/10.1137/0905021.

    Example:
        >>> curve = MonotoneCubic([0.0, 1.0, 2.0], [0.0, 3.0, 3.0])
        >>> curve(torch.tensor([0.0, 1.0, 1.7])).tolist()
        [0.0, 3.0, 3.0]
    """

    def __init__(self, knots: Sequence[float], values: Sequence[float]) -> None:
        curve = PchipInterpolator(knots, values)
        self._knots = torch.tensor(knots, dtype=torch.double)
        self._cubics = torch.from_numpy(curve.c.copy())
        self._slopes = torch.from_numpy(curve.derivative().c.copy())

    def __call__(self, x: Tensor) -> Tensor:
        """Values at arguments of any shape, in their precision."""
        return self._evaluate(self._cubics, x)

    def derivative(self, x: Tensor) -> Tensor:
        """Derivatives at arguments of any shape, in their precision."""
        return self._evaluate(self._slopes, x)

    def _evaluate(self, coefficients: Float[Tensor, "order pieces"], x: Tensor) -> Tensor:
        """Evaluate the polynomial of the piece that holds each argument by Horner's scheme, highest power first."""
        knots, coefficients = self._knots.to(x), coefficients.to(x)
        piece = torch.searchsorted(knots[1:-1], x.detach(), right=True)
        since = x - knots[piece]
        value = torch.zeros_like(x)
        for row in coefficients:
            value = value * since + row[piece]
        return value
