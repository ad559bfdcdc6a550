"""Derivatives of fields by finite differences, for those that know no derivative of their own."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.types import SignedDistance


def finite_gradient(field: SignedDistance, points: Float[Tensor, "n d"], step: float) -> Float[Tensor, "n d"]:
    """Gradient of a field by central differences, with an error of O(step²).

    Args:
        field: Maps points, shape (n, d), to values, shape (n,).
        points: Where the gradient is taken, shape (n, d).
        step: Distance from each point to those that are compared, a length.

    Example:
        >>> import torch
        >>> from nsm.geometry.differences import finite_gradient
        >>> finite_gradient(lambda x: x.square().sum(1), torch.tensor([[1.0, 2.0]]), 0.25)
        tensor([[2., 4.]])
    """
    with torch.no_grad():
        shifts = step * torch.eye(points.shape[1], dtype=points.dtype, device=points.device)
        return torch.stack([field(points + s) - field(points - s) for s in shifts], 1) / (2 * step)
