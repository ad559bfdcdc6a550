"""Points on the surface of f, which is known only while it is being learned."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from nsm.cli.errors import InputError
from nsm.sampling.batch import Batch
from nsm.types import Jet, SignedDistance

#: ‖∇f‖² is not taken smaller than this when a point is moved to the surface.
_LEAST_SLOPE = 0.05


class SurfacePoints(nn.Module):
    """Points (x, t) on the surface {f(·, t) = 0} as one step leaves them for the next.

    They are part of the state, so that a resumed run goes on with the same ones.

    Args:
        dim: Dimension d of space.
        size: How many points are kept.
    """

    points: Tensor
    found: Tensor

    def __init__(self, dim: int, size: int) -> None:
        super().__init__()
        self.register_buffer("points", torch.zeros(size, dim + 1))
        self.register_buffer("found", torch.zeros((), dtype=torch.bool))

    def __len__(self) -> int:
        return len(self.points)

    @property
    def ready(self) -> bool:
        """Whether any point has been found."""
        return len(self) > 0 and bool(self.found)

    def keep(self, points: Float[Tensor, "n k"]) -> None:
        """Keep the first of some points (n, d + 1), repeated if there are too few; the old ones if there is none."""
        if len(self) and len(points):
            self.points.copy_(points[torch.arange(len(self), device=points.device) % len(points)])
            self.found.fill_(True)


class MovingSurface(SurfacePoints):
    """Draws a part of the interior points around the moving surface, where volume is won or lost.

    Each step moves its interior points with |f| < reach to the surface, x − f ∇f / ‖∇f‖², by the jet that it computes
    anyway; the next step draws around them. Points that were drawn afresh from space and time come first and the oldest
    leave, so that a new piece of the surface is found wherever and whenever it appears.

    Args:
        dim: Dimension d of space.
        interior: Interior points in a batch.
        fraction: Part of them drawn around the surface.
        width: Half the edge of the cube around a surface point in which one is drawn, a length.
        reach: Largest |f| at which a point is moved to the surface, a length.
    """

    def __init__(self, dim: int, interior: int, fraction: float, width: float, reach: float) -> None:
        super().__init__(dim, round(_part("near.fraction", fraction) * interior))
        self.dim, self.width, self.reach = dim, float(width), float(reach)

    def place(self, batch: Batch, half_width: float) -> Batch:
        """Move the last interior points of a batch next to the surface.

        Args:
            batch: Its interior points are uniform in [−half_width, half_width]^d; the draw that a point loses becomes
                its offset from the surface, so nothing else needs to be drawn.
            half_width: Half the edge of the training box.
        """
        if not self.ready:
            return batch
        points = batch.points.clone()
        moved = points[len(points) - len(self) :]  # a view: written through
        offset = moved[:, : self.dim] * (self.width / half_width)
        moved.copy_(self.points)
        moved[:, : self.dim] += offset
        return batch._replace(points=points)

    @torch.no_grad()
    def follow(self, batch: Batch, f: Jet) -> None:
        """Take the surface points next to the interior points of a batch, where f has the jet given."""
        on, _ = _onto_surface(batch.points[batch.interior], f, self.reach)
        self.keep(on)


class EndSurfaces(SurfacePoints):
    """Puts ambient points on f's own surface at t = 0 and t = 1, with their distance to the shape there.

    A piece of one shape that is left over at the other's end lies far from all points of the other's surface: only such
    points see it. Half of those kept are the ones that are farthest from the shape, so that a small leftover holds
    points until it is gone. It usually lies where the shape is at another time, so some more ambient points are
    visitors: points of the moving surface, looked at at t = 0 or t = 1.

    Args:
        dim: Dimension d of space.
        ambient: Ambient points in a batch.
        own: Part of them around f's own surface.
        visitors: Part of them taken from the moving surface.
        width: Half the edge of the cube around a point of f's own surface in which one is drawn, a length.
        reach: Largest |f| at which a point is moved to the surface, a length.
    """

    chosen: Tensor

    def __init__(self, dim: int, ambient: int, own: float, visitors: float, width: float, reach: float) -> None:
        super().__init__(dim, round(_part("ends.own", own) * ambient))
        self.dim, self.width, self.reach = dim, float(width), float(reach)
        self.visitors = min(round(_part("ends.visitors", visitors) * ambient), ambient - len(self))
        # a fixed shuffle, so that both ends lose as many of their drawn points
        order = torch.randperm(ambient, generator=torch.Generator().manual_seed(0))
        self.register_buffer("chosen", order[: len(self) + self.visitors], persistent=False)

    @torch.no_grad()
    def place(
        self, batch: Batch, moving: SurfacePoints, half_width: float, source: SignedDistance, target: SignedDistance
    ) -> Batch:
        """Replace ambient points of a batch by points of f's own surface and by visitors, with their distances.

        Args:
            batch: Its interior points are uniform in [−half_width, half_width]^d.
            moving: Points of the moving surface.
            half_width: Half the edge of the training box.
            source, target: Signed distances of the end shapes.
        """
        points = torch.cat([self._around(batch, half_width), self._visiting(moving)])
        if not len(points):
            return batch
        index = batch.ambient.start + self.chosen[: len(points)]
        space, at_start = points[:, : self.dim], points[:, -1] < 0.5
        everything, distances = batch.points.clone(), batch.distances.clone()
        everything[index] = points
        distances[index[at_start]] = source(space[at_start])
        distances[index[~at_start]] = target(space[~at_start])
        return batch._replace(points=everything, distances=distances)

    @torch.no_grad()
    def follow(self, batch: Batch, f: Jet) -> None:
        """Take the surface points next to the ambient points of a batch, where f has the jet given at all points."""
        ambient = batch.ambient
        on, close = _onto_surface(batch.points[ambient], Jet(*(part[ambient] for part in f)), self.reach)
        farthest = batch.distances[ambient][close].abs().argsort(descending=True)
        hard, rest = farthest.split([half := min(len(on), len(self) // 2), len(on) - half])
        evenly = torch.linspace(0, max(len(rest) - 1, 0), min(len(rest), len(self) - half)).long()
        self.keep(on[torch.cat([hard, rest[evenly.to(rest.device)]])])

    def _around(self, batch: Batch, half_width: float) -> Float[Tensor, "n k"]:
        """The points that are kept, moved about by what the first interior points were drawn with."""
        if not self.ready:
            return self.points[:0]
        around = self.points.clone()
        drawn = batch.points[batch.interior][: len(self), : self.dim]
        around[: len(drawn), : self.dim] += drawn * (self.width / half_width)
        return around

    def _visiting(self, moving: SurfacePoints) -> Float[Tensor, "m k"]:
        """Points of the moving surface, at t = 0 and 1 in turn."""
        if not moving.ready:
            return self.points[:0]
        turn = torch.arange(self.visitors, device=self.points.device)
        visitors = moving.points[turn % len(moving)]
        visitors[:, -1] = turn % 2
        return visitors


def _onto_surface(p: Float[Tensor, "n k"], f: Jet, reach: float) -> tuple[Float[Tensor, "m k"], Bool[Tensor, " n"]]:
    """The points with |f| < reach, moved to the surface at their own time; and which of the n they are."""
    close = f.value.abs() < reach
    space = slice(0, p.shape[1] - 1)
    gradient = f.gradient[close, space]
    on = p[close].clone()
    on[:, space] -= (f.value[close] / gradient.square().sum(1).clamp(min=_LEAST_SLOPE))[:, None] * gradient
    return on, close


def _part(name: str, value: float) -> float:
    if not 0 <= value <= 1:
        raise InputError(f"`sampler.{name}` must be a fraction between 0 and 1, got {value}. Try `sampler.{name}=0.3`.")
    return float(value)
