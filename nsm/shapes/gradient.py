"""Gradients of signed distances, exact where they are known."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from nsm.geometry.differences import finite_gradient
from nsm.shapes.base import FieldShape
from nsm.types import SignedDistance


def shape_gradient(shape: SignedDistance, x: Float[Tensor, "n d"], step: float) -> Float[Tensor, "n d"]:
    """Gradient of a signed distance (n, d), exact for a `FieldShape`, and from central differences for other functions.

    Differences would round the edges of a mesh over the length of their step.

    Args:
        shape: Signed distance.
        x: Where the gradient is taken, shape (n, d).
        step: Distance from each point to those that the differences compare, a length.

    Example:
        >>> import torch
        >>> from nsm.shapes import Ball
        >>> from nsm.shapes.gradient import shape_gradient
        >>> shape_gradient(Ball(0.5, [0.0, 0.0]), torch.tensor([[0.0, 0.7]]), 1e-3)
        tensor([[0., 1.]])
    """
    if isinstance(shape, FieldShape):
        return shape.jet(x).gradient
    return finite_gradient(shape, x, step)
