"""Projection of points to a level set along the gradient."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nsm.geometry.grid import CHUNK
from nsm.types import Jet

#: A point has converged when its remaining distance to the level is at most this fraction of the reach.
_CONVERGED = 1e-2
#: Multiple of the spacing of floating-point numbers below which a value cannot be told from the level.
_ROUNDING = 8


class Projected(NamedTuple):
    """Points projected to a level set.

    Attributes:
        points: Projected points, shape (n, d).
        stayed: Whether a point was left in place because the level set is out of its reach, shape (n,).
    """

    points: Float[Tensor, "n d"]
    stayed: Bool[Tensor, " n"]


def newton_to_level(
    jet: Callable[[Tensor], Jet], x: Float[Tensor, "n d"], steps: int = 3, reach: float = 0.05, level: float = 0.0
) -> tuple[Float[Tensor, "n d"], Jet]:
    """Move points toward {g = c} by Newton steps x ← x − (g − c) ∇g / ‖∇g‖², each at most ``reach`` long.

    Three steps usually bring a point from within a cell of a grid to rounding error. A point that is there stays, and g
    is not evaluated at it again.

    Args:
        jet: A function that returns value and gradient of g at points, shape (n, d).
        x: Points, shape (n, d).
        steps: Maximum number of steps.
        reach: Maximum length of a step.
        level: The level c.

    Returns:
        The points, shape (n, d), and the jet of g at them.

    Example:
        >>> import torch
        >>> from nsm.geometry.projection import newton_to_level
        >>> from nsm.shapes import Ball
        >>> points, jet = newton_to_level(Ball(radius=0.5).jet, torch.tensor([[0.52, 0.0, 0.0]]), steps=1)
        >>> points
        tensor([[0.5000, 0.0000, 0.0000]])
    """
    parts = [_newton_steps(jet, chunk, steps, reach, level) for chunk in x.split(CHUNK)]
    points, values, gradients = (torch.cat(part) for part in zip(*parts, strict=True))
    return points, Jet(values, gradients)


def _newton_steps(
    jet: Callable[[Tensor], Jet], x: Tensor, steps: int, reach: float, level: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Positions after the steps, and value and gradient of g there."""
    value, gradient = (part.detach() for part in jet(x))
    x = x.detach().to(torch.promote_types(x.dtype, value.dtype))
    rounding = _ROUNDING * torch.finfo(value.dtype).eps
    for _ in range(steps):
        away = ~((value - level).abs() <= rounding)  # values that are not finite too
        if not away.any():
            break
        step = (value[away] - level)[:, None] * gradient[away]
        step = step / gradient[away].square().sum(1, keepdim=True).clamp(min=1e-12)
        length = step.norm(dim=1, keepdim=True).clamp(min=1e-12)
        x = x.masked_scatter(away[:, None], x[away] - step * (reach / length).clamp(max=1))
        there = jet(x[away])
        value = value.masked_scatter(away, there.value.detach())
        gradient = gradient.masked_scatter(away[:, None], there.gradient.detach())
    return x, value, gradient


@torch.no_grad()
def project_to_level(
    jet: Callable[[Tensor], Jet], x: Float[Tensor, "n d"], level: float = 0.0, steps: int = 3, reach: float = 0.05
) -> Projected:
    """Project points to the level set {g = c} where it is within reach, and leave the other points in place.

    A point stays in place if Newton's method does not converge, for example because ∇g vanishes, or ends farther than
    ``reach`` from its start. The result is finite wherever x is.

    Args:
        jet: A function that returns value and gradient of g at points, shape (n, d).
        x: Points, shape (n, d).
        level: The level c.
        steps: Number of Newton steps.
        reach: Maximum displacement of a point, in length.

    Example:
        >>> import torch
        >>> from nsm.geometry.projection import project_to_level
        >>> from nsm.shapes import Ball
        >>> x = torch.tensor([[0.52, 0.0, 0.0], [0.9, 0.0, 0.0]])
        >>> project_to_level(Ball(radius=0.5).jet, x, reach=0.1).stayed
        tensor([False,  True])
    """
    moved, there = newton_to_level(jet, x, steps, reach, level)
    remaining = (there.value - level).abs()
    # comparisons with NaN are false, so a point that is not finite has not converged
    converged = (remaining <= _CONVERGED * reach * there.gradient.norm(dim=1)) & ((moved - x).norm(dim=1) <= reach)
    return Projected(torch.where(converged[:, None], moved, x), ~converged)
