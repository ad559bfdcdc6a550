"""Sample a field on a regular lattice, but only where its zero set can be.

A surface meets a share O(1/r) of the r^d points of a lattice. So the lattice is cut into blocks, the field is
evaluated at the middle of each, and only blocks that can hold the surface are sampled in full: with c the middle
and R the radius of a block, there is no zero in it when |f(c)| > L R, L a bound on the slope of f nearby. L is
measured from the samples themselves; should it prove too small, so that the surface reaches the rim of the
sampled blocks, their neighbours are sampled as well, until it does not.
"""

from __future__ import annotations

from itertools import product
from math import prod
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from nsm.types import SignedDistance

#: Points along an edge of a block.
BLOCK = 4
#: Points evaluated at once: large enough to keep matrix products busy, small enough to stay in cache.
CHUNK = 1 << 15
#: The measured slope is a maximum over few samples; the true one may be this much larger.
SAFETY = 1.5


class Lattice(NamedTuple):
    """Points ``origin + step * index`` for every index below ``shape``; origin and step are (d,) tensors."""

    origin: Float[Tensor, " d"]
    step: Float[Tensor, " d"]
    shape: tuple[int, ...]

    @classmethod
    def centres(cls, bounds: Float[Tensor, "2 d"], resolution: int) -> Lattice:
        """The middles of the cells that cut a box, ``resolution`` of them along its longest edge."""
        step, cells = _cells(bounds, resolution)
        return cls(bounds[0] + step / 2, step, cells)

    @classmethod
    def corners(cls, bounds: Float[Tensor, "2 d"], resolution: int) -> Lattice:
        """The corners of the cells that cut a box, ``resolution + 1`` of them along its longest edge."""
        step, cells = _cells(bounds, resolution)
        return cls(bounds[0], step, tuple(n + 1 for n in cells))

    def points(self, index: Shaped[Tensor, "*n d"]) -> Float[Tensor, "*n d"]:
        """Points (..., d) at indices (..., d), which need not be whole."""
        return self.origin + self.step * index


class Band(NamedTuple):
    """Values on a lattice, exact where ``known``; elsewhere a value of the right sign, well away from zero."""

    values: Float[Tensor, " *shape"]
    known: Bool[Tensor, " *shape"]


def evaluate(field: SignedDistance, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """Values (n,) of a field at any number of points, a chunk at a time and without a graph."""
    with torch.no_grad():
        if len(points) <= CHUNK:
            return field(points)
        return torch.cat([field(chunk) for chunk in points.split(CHUNK)])


def sample_band(field: SignedDistance, lattice: Lattice) -> Band:
    """Sample a field on a lattice wherever a cell around a point, or between points, can be cut by its zero set.

    Args:
        field: maps points (n, d) to values (n,); any continuous function, not only a distance.
        lattice: where to sample.

    Returns:
        The `Band`; ``values`` and ``known`` have the shape of the lattice.
    """
    dim = len(lattice.shape)
    blocks = tuple(-(-n // BLOCK) for n in lattice.shape)
    index = _indices(blocks, lattice.step.device)
    middle = lattice.points(index * BLOCK + (BLOCK - 1) / 2)
    coarse = evaluate(field, middle).view(blocks)
    slope = _slope(coarse, lattice.step * BLOCK)
    # half a block's diagonal to its outermost points, and one more cell around for neighbours
    radius = (BLOCK + 1) / 2 * lattice.step.norm()
    wanted = coarse.abs() <= SAFETY * slope * radius

    values = _spread(coarse, lattice.shape)
    known = torch.zeros(lattice.shape, dtype=torch.bool, device=values.device)
    done = torch.zeros_like(wanted)
    offsets = _indices((BLOCK,) * dim, values.device)
    limit = torch.tensor(lattice.shape, device=values.device)
    # one cell's diagonal: closer to zero than this, a point may have the surface in its cell
    near = SAFETY * lattice.step.norm() * (slope[wanted].max() if wanted.any() else 0.0)
    while (fresh := wanted & ~done).any():
        fine = (fresh.nonzero()[:, None] * BLOCK + offsets).reshape(-1, dim)
        fine = fine[(fine < limit).all(1)]
        where = tuple(fine.T)
        values[where] = evaluate(field, lattice.points(fine)).to(values.dtype)
        known[where] = True
        done |= fresh
        wanted = done | _reached(values, coarse, fresh, done, near)
    return Band(values, known)


def _cells(bounds: Tensor, resolution: int) -> tuple[Tensor, tuple[int, ...]]:
    extent = bounds[1] - bounds[0]
    if resolution < 1 or not bool((extent > 0).all()):
        raise ValueError(
            f"a grid needs resolution >= 1 and bounds whose first row lies below the second, "
            f"not resolution={resolution} and bounds={bounds.tolist()}"
        )
    counts = (resolution * extent / extent.max()).round().clamp(min=1)
    return extent / counts, tuple(int(n) for n in counts)


def _indices(shape: tuple[int, ...], device: torch.device) -> Int[Tensor, "n d"]:
    axes = [torch.arange(n, device=device) for n in shape]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).view(prod(shape), len(shape))


def _slope(coarse: Tensor, step: Float[Tensor, " d"]) -> Tensor:
    """Steepest gradient seen among the neighbours of each block, from differences between middles."""
    squared = torch.zeros_like(coarse)
    for axis, length in enumerate(step):
        if coarse.shape[axis] < 2:
            continue
        difference = coarse.diff(dim=axis).abs() / length
        edge = torch.zeros_like(coarse.narrow(axis, 0, 1))
        squared += torch.maximum(torch.cat([difference, edge], axis), torch.cat([edge, difference], axis)) ** 2
    if not bool(squared.any()):  # one block, or a constant: nothing can be excluded
        return torch.full_like(coarse, torch.inf)
    pool = F.max_pool3d if coarse.ndim == 3 else F.max_pool2d
    return pool(squared[None, None], 3, stride=1, padding=1)[0, 0].sqrt()


def _spread(coarse: Tensor, shape: tuple[int, ...]) -> Tensor:
    """The value of each block at all of its points."""
    fine = coarse
    for axis, n in enumerate(shape):
        fine = fine.repeat_interleave(BLOCK, axis).narrow(axis, 0, n)
    return fine.clone()


def _reached(values: Tensor, coarse: Tensor, fresh: Tensor, done: Tensor, near: Tensor | float) -> Tensor:
    """Blocks (as a mask), not sampled yet, that the surface may enter from one sampled just now.

    It may where a point on the face between them is near zero, or has not the sign of the middle of the other block.
    """
    dim = values.ndim
    offsets = _indices((BLOCK,) * dim, values.device)
    last = torch.tensor(values.shape, device=values.device) - 1
    blocks = fresh.nonzero()
    reached = torch.zeros_like(done)
    for axis, forward in product(range(dim), (True, False)):
        face = offsets[offsets[:, axis] == (BLOCK - 1 if forward else 0)]
        beside = blocks.clone()
        beside[:, axis] += 1 if forward else -1
        there = (beside[:, axis] >= 0) & (beside[:, axis] < done.shape[axis])
        here, beside = blocks[there], beside[there]
        unknown = ~done[tuple(beside.T)]
        here, beside = here[unknown], beside[unknown]
        points = torch.minimum(here[:, None] * BLOCK + face, last)
        on_face = values[tuple(points.movedim(-1, 0))]
        crossed = (on_face < 0) != (coarse[tuple(beside.T)] < 0)[:, None]
        touched = ((on_face.abs() <= near) | crossed).any(1)
        reached[tuple(beside[touched].T)] = True
    return reached
