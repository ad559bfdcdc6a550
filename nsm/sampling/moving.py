"""Points on the surface of f, which moves while f is being trained."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from nsm.cli import settings
from nsm.sampling.batch import Batch
from nsm.types import Jet, Key, SignedDistance

#: Lower bound on ‖∇f‖² when a point is projected to the surface.
_MIN_SQUARED_SLOPE = 0.05


class SurfacePoints(nn.Module):
    """Points (x, t) on the surface {f(·, t) = 0}, updated in each training step for the next.

    They belong to the state of the module, so that a resumed run continues with the same points.

    Args:
        dim: Dimension d of space.
        size: Number of points to keep.
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
        """Whether any point on the surface has been found."""
        return len(self) > 0 and bool(self.found)

    def keep(self, points: Float[Tensor, "n k"]) -> None:
        """Store the first of some points, shape (n, d + 1), cyclically if too few; without any, keep the old ones."""
        if len(self) and len(points):
            self.points.copy_(points[torch.arange(len(self), device=points.device) % len(points)])
            self.found.fill_(True)


class MovingSurface(SurfacePoints):
    """A sampler that moves a fraction of the interior points near the moving surface, where volume changes.

    Each step projects its interior points with |f| < reach to the surface, x − f ∇f / ‖∇f‖², using the jet that it
    computes anyway, and the next step draws points around them. Newly drawn points take precedence and replace the
    oldest, so that a new component of the surface is found at any place and time.

    Args:
        dim: Dimension d of space.
        interior: Number of interior points in a batch.
        fraction: Fraction of them drawn near the surface.
        width: Half the edge of the cube around a surface point in which a point is drawn, in length.
        reach: Largest |f| at which a point is projected to the surface, in length.

    Raises:
        InputError: If ``fraction`` is not in [0, 1].
    """

    def __init__(self, dim: int, interior: int, fraction: float, width: float, reach: float) -> None:
        super().__init__(dim, round(settings.fraction("sampler.near.fraction", fraction, example=0.3) * interior))
        self.dim, self.width, self.reach = dim, float(width), float(reach)

    def place(self, batch: Batch, half_width: float) -> Batch:
        """Move the last interior points of a batch near the surface.

        Args:
            batch: A batch whose interior points are uniform in [−half_width, half_width]^d. The position that a point
                loses, scaled, becomes its offset from the surface, so that no further random numbers are needed.
            half_width: Half the edge of the training box.
        """
        if not self.ready:
            return batch
        points = batch.points.clone()
        moved = points[len(points) - len(self) :]  # a view into points
        offset = moved[:, : self.dim] * (self.width / half_width)
        moved.copy_(self.points)
        moved[:, : self.dim] += offset
        return batch._replace(points=points)

    @torch.no_grad()
    def follow(self, batch: Batch, f: Jet) -> None:
        """Store the projections of interior points to the surface, given the jet of f at the interior points."""
        on, _ = _onto_surface(batch.points[batch.interior], f, self.reach)
        self.keep(on)


class EndSurfaces(SurfacePoints):
    """A sampler that moves ambient points to f's own surface at the time of a key, with their distance to its shape.

    A component of f that does not belong to a key lies far from all points sampled around its shape, so only points on
    f's own surface detect it. Half of the stored points are those farthest from the shape of their key, so that a
    small spurious component keeps its points until it disappears. Such a component usually lies where the shape is at
    other times; some further ambient points are therefore *visitors*, points of the moving surface at other times
    evaluated at the time of a key.

    Args:
        dim: Dimension d of space.
        ambient: Number of ambient points in a batch.
        own: Fraction of them around f's own surface.
        visitors: Fraction of them taken from the moving surface.
        width: Half the edge of the cube around a point of f's own surface in which a point is drawn, in length.
        reach: Largest |f| at which a point is projected to the surface, in length.

    Raises:
        InputError: If ``own`` or ``visitors`` is not in [0, 1].
    """

    chosen: Tensor

    def __init__(self, dim: int, ambient: int, own: float, visitors: float, width: float, reach: float) -> None:
        super().__init__(dim, round(settings.fraction("sampler.ends.own", own) * ambient))
        self.dim, self.width, self.reach = dim, float(width), float(reach)
        visitors = settings.fraction("sampler.ends.visitors", visitors, example=0.25)
        self.visitors = min(round(visitors * ambient), ambient - len(self))
        # a fixed permutation, so that all keys lose about equally many of their sampled points
        order = torch.randperm(ambient, generator=torch.Generator().manual_seed(0))
        self.register_buffer("chosen", order[: len(self) + self.visitors], persistent=False)

    @torch.no_grad()
    def place(
        self, batch: Batch, moving: SurfacePoints, half_width: float, keys: Sequence[Key[SignedDistance]]
    ) -> Batch:
        """Replace ambient points of a batch by points near f's own surface and by visitors, with their distances.

        Args:
            batch: A batch whose interior points are uniform in [−half_width, half_width]^d.
            moving: Points of the moving surface.
            half_width: Half the edge of the training box.
            keys: Signed distances of the shapes that the morph passes through.
        """
        points = torch.cat([self._around(batch, half_width), self._visiting(moving, keys)])
        if not len(points):
            return batch
        index = batch.ambient.start + self.chosen[: len(points)]
        everything, distances = batch.points.clone(), batch.distances.clone()
        everything[index] = points
        of = nearest_key(points[:, -1], keys)
        for number, key in enumerate(keys):
            mine = of == number
            distances[index[mine]] = key.shape(points[mine, : self.dim])
        return batch._replace(points=everything, distances=distances)

    @torch.no_grad()
    def follow(self, batch: Batch, f: Jet) -> None:
        """Store the projections of ambient points to the surface, given the jet of f at all points of the batch."""
        ambient = batch.ambient
        on, close = _onto_surface(batch.points[ambient], Jet(*(part[ambient] for part in f)), self.reach)
        farthest = batch.distances[ambient][close].abs().argsort(descending=True)
        far, rest = farthest.split([half := min(len(on), len(self) // 2), len(on) - half])
        evenly = torch.linspace(0, max(len(rest) - 1, 0), min(len(rest), len(self) - half)).long()
        self.keep(on[torch.cat([far, rest[evenly.to(rest.device)]])])

    def _around(self, batch: Batch, half_width: float) -> Float[Tensor, "n k"]:
        """Offset the stored points at random, by the scaled positions of the first interior points."""
        if not self.ready:
            return self.points[:0]
        around = self.points.clone()
        drawn = batch.points[batch.interior][: len(self), : self.dim]
        around[: len(drawn), : self.dim] += drawn * (self.width / half_width)
        return around

    def _visiting(self, moving: SurfacePoints, keys: Sequence[Key[SignedDistance]]) -> Float[Tensor, "m k"]:
        """Take points of the moving surface and set their times to those of the keys in turn."""
        if not moving.ready:
            return self.points[:0]
        turn = torch.arange(self.visitors, device=self.points.device)
        visitors = moving.points[turn % len(moving)]
        visitors[:, -1] = torch.tensor([key.time for key in keys]).to(visitors)[turn % len(keys)]
        return visitors


def nearest_key(t: Float[Tensor, " n"], keys: Sequence[Key[SignedDistance]]) -> Int[Tensor, " n"]:
    """Number of the key whose time is nearest to each of n times, shape (n,).

    >>> nearest_key(torch.tensor([0.0, 0.3, 1.0]), [Key(0.0, torch.norm), Key(0.4, torch.norm), Key(1.0, torch.norm)])
    tensor([0, 1, 2])
    """
    return (t[:, None] - torch.tensor([key.time for key in keys]).to(t)).abs().argmin(1)


def _onto_surface(p: Float[Tensor, "n k"], f: Jet, reach: float) -> tuple[Float[Tensor, "m k"], Bool[Tensor, " n"]]:
    """Project the points with |f| < reach to the surface at their own time, and mark which of the n points they are."""
    close = f.value.abs() < reach
    space = slice(0, p.shape[1] - 1)
    gradient = f.gradient[close, space]
    on = p[close].clone()
    on[:, space] -= (f.value[close] / gradient.square().sum(1).clamp(min=_MIN_SQUARED_SLOPE))[:, None] * gradient
    return on, close
