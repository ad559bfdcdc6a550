"""Points on the moving surface, known only while it is being learned."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm.errors import InputError
from nsm.sampling.batch import Batch
from nsm.types import Jet

#: ‖∇f‖² is not taken smaller than this when a point is moved to the surface.
_LEAST_SLOPE = 0.05


class MovingSurface(nn.Module):
    """Draws a part of the interior points around the surface {f(·, t) = 0} of the moment, where volume is won or lost.

    Interior points of one step that have |f| < reach are moved to the surface, x − f ∇f / ‖∇f‖², with the jet that the
    step computed anyway; the next step draws around them. So the points follow the surface at no cost.
    They are part of the state, so that a resumed run draws the same.

    Args:
        dim: dimension d of space.
        interior: interior points in a batch.
        fraction: part of them drawn around the surface.
        width: half the edge of the cube around a surface point in which one is drawn.
        reach: how far from the surface a point may be to be moved there.
    """

    points: Tensor
    found: Tensor

    def __init__(self, dim: int, interior: int, fraction: float, width: float, reach: float) -> None:
        super().__init__()
        if not 0 <= fraction <= 1:
            raise InputError(f"sampler.near.fraction={fraction} is no part of the interior points: give 0 to 1")
        self.dim, self.width, self.reach = dim, float(width), float(reach)
        self.register_buffer("points", torch.zeros(round(fraction * interior), dim + 1))
        self.register_buffer("found", torch.zeros((), dtype=torch.bool))

    def place(self, batch: Batch, half_width: float) -> Batch:
        """The batch, its first interior points moved next to the surface.

        Args:
            batch: interior points uniform in [−half_width, half_width]^d; the draw that a point loses becomes its
                offset from the surface, so nothing else needs to be drawn.
            half_width: of the box.
        """
        count = len(self.points)
        if count == 0 or not self.found:
            return batch
        points = batch.points.clone()
        moved = points[batch.interior][:count]  # a view: written through
        offset = moved[:, : self.dim] * (self.width / half_width)
        moved.copy_(self.points)
        moved[:, : self.dim] += offset
        return batch._replace(points=points)

    @torch.no_grad()
    def follow(self, p: Float[Tensor, "n k"], f: Jet) -> None:
        """Take the surface points next to p (n, d + 1), where f has the jet given."""
        close = f.value.abs() < self.reach
        if len(self.points) == 0 or not close.any():
            return
        gradient = f.gradient[close, : self.dim]
        step = f.value[close] / gradient.square().sum(1).clamp(min=_LEAST_SLOPE)
        on = p[close].clone()
        on[:, : self.dim] -= step[:, None] * gradient
        self.points.copy_(on[torch.arange(len(self.points), device=on.device) % len(on)])
        self.found.fill_(True)
