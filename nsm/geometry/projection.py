"""Points moved to a level set, along the gradient."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nsm.geometry.grid import CHUNK
from nsm.types import Jet

#: A point has arrived when what is left of the way to the level is this part of the way it may go.
_ARRIVED = 1e-2


class Projected(NamedTuple):
    """Points (n, d) moved to a level set, and which of them (n,) stayed where they were, for it is out of reach."""

    points: Float[Tensor, "n d"]
    stayed: Bool[Tensor, " n"]


def newton_to_level(
    jet: Callable[[Tensor], Jet], x: Float[Tensor, "n d"], steps: int = 3, reach: float = 0.05, level: float = 0.0
) -> tuple[Float[Tensor, "n d"], Jet]:
    """Move points towards a level by Newton steps x ← x − (g − c) ∇g / |∇g|², none longer than ``reach``.

    Three steps take a point that lies within a cell of a grid to rounding error.

    Args:
        jet: value and gradient of g at points (n, d).
        x: points (n, d).
        steps: how many.
        reach: greatest length of a step.
        level: c.

    Returns:
        the points (n, d), and the jet there.
    """
    moved, values, gradients = [], [], []
    for chunk in x.split(CHUNK):
        here = jet(chunk)
        for _ in range(steps):
            step = (here.value - level)[:, None] * here.gradient
            step = step / here.gradient.square().sum(1, keepdim=True).clamp(min=1e-12)
            length = step.norm(dim=1, keepdim=True).clamp(min=1e-12)
            chunk = (chunk - step * (reach / length).clamp(max=1)).detach()
            here = jet(chunk)
        moved.append(chunk)
        values.append(here.value.detach())
        gradients.append(here.gradient.detach())
    return torch.cat(moved), Jet(torch.cat(values), torch.cat(gradients))


@torch.no_grad()
def project_to_level(
    jet: Callable[[Tensor], Jet], x: Float[Tensor, "n d"], level: float = 0.0, steps: int = 3, reach: float = 0.05
) -> Projected:
    """The points of a level set next to x, where there are such; other points stay where they are.

    A point stays if Newton's method does not arrive (where ∇g vanishes, or beyond the reach), or ends further than
    ``reach`` from where it began. No result is less finite than x.

    Args:
        jet: value and gradient of g at points (n, d).
        x: points (n, d).
        level: c of {g = c}.
        steps: of Newton's method.
        reach: how far a point may be moved, in units of length.
    """
    moved, there = newton_to_level(jet, x, steps, reach, level)
    left = (there.value - level).abs()
    # written so that what is not a number has not arrived
    arrived = (left <= _ARRIVED * reach * there.gradient.norm(dim=1)) & ((moved - x).norm(dim=1) <= reach)
    return Projected(torch.where(arrived[:, None], moved, x), ~arrived)
