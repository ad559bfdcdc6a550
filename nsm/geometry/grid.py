"""Sample a field on a regular lattice, but only where its zero set can be.

A surface meets a share O(1/r) of the r^d points of a lattice. So the lattice is cut into blocks, the field is evaluated
at the middle of each, and blocks that can hold the surface are cut into halves, down to small ones that are sampled in
full: with c the middle and R the radius of a block, there is no zero in it when |f(c)| > L R, L a bound on the slope of
f nearby. L is 1.5 times the steepest slope measured there, among neighbouring large blocks everywhere and again among
the parts of each block that is cut. Where that is a bound, nothing is missed, however small or far from the rest: of a
distance, a ball smaller than a cell and visible in no coarse sample still is found. Should it prove too small, so that
the surface reaches the rim of the sampled blocks, their neighbours are sampled as well, until it does not; so what is
missed is at most a whole component, between large blocks where f looks flatter than it is.

Only sampled blocks are stored: memory grows as the surface does.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import prod
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from nsm.types import SignedDistance

#: Points along an edge of the smallest blocks, which are sampled in full.
BLOCK = 2
#: The largest blocks are doubled as long as this many of them fit along the longest edge, unless told otherwise.
COARSE = 32
#: Points evaluated at once: large enough to keep matrix products busy, small enough to stay in cache.
CHUNK = 1 << 15
#: The measured slope is a maximum over few samples; the true one may be this much larger.
SAFETY = 1.5
#: The same among the smallest blocks, whose neighbours are sampled as well should it not be enough.
_FINE_SAFETY = 1.1
#: Points along an edge of a brick, by dimension: what is laid out in full at a time.
_BRICK = {2: 256, 3: 32}


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


class Window(NamedTuple):
    """Part of a lattice from index ``low`` on: values, exact where ``known``, elsewhere of the right sign."""

    low: tuple[int, ...]
    values: Float[Tensor, " *shape"]
    known: Bool[Tensor, " *shape"]


class Band(NamedTuple):
    """Values on a lattice near the zero set of a field.

    Attributes:
        lattice: all of the points.
        far: one value of the right sign for each block, away from zero where the block is not sampled.
        slot: for each block its row in ``values``, -1 where it is not sampled.
        values: of the sampled blocks, ``BLOCK`` points along each edge; beyond the end of the lattice repeated.
        slope: typical steepness of the field near its zero set, 1 for a distance.
    """

    lattice: Lattice
    far: Float[Tensor, " *blocks"]
    slot: Int[Tensor, " *blocks"]
    values: Float[Tensor, " k *block"]
    slope: float

    def window(self, low: tuple[int, ...], high: tuple[int, ...]) -> Window:
        """The points whose index is at least ``low`` and below ``high``, cut to the lattice."""
        low = tuple(max(i, 0) for i in low)
        high = tuple(min(i, n) for i, n in zip(high, self.lattice.shape, strict=True))
        dim, first = len(low), [i // BLOCK for i in low]
        blocks = tuple(slice(i, -(-j // BLOCK)) for i, j in zip(first, high, strict=True))
        slot = self.slot[blocks]
        known = (slot >= 0)[(...,) + (None,) * dim].expand(slot.shape + (BLOCK,) * dim)
        values = self.far[blocks][(...,) + (None,) * dim].expand(known.shape).clone()
        values[slot >= 0] = self.values[slot[slot >= 0]]
        inner = tuple(slice(i - BLOCK * b, j - BLOCK * b) for i, j, b in zip(low, high, first, strict=True))
        return Window(low, _laid_out(values)[inner], _laid_out(known)[inner])

    def whole(self) -> Window:
        """All points of the lattice."""
        return self.window((0,) * len(self.lattice.shape), self.lattice.shape)

    def bricks(self, before: int = 0, after: int = 0) -> Iterator[tuple[Window, tuple[slice, ...]]]:
        """Bricks of one size, side by side, that together hold all sampled points.

        Yields:
            The window of a brick and of some points more before and after it, and where in it the brick is.
        """
        size = _BRICK[len(self.lattice.shape)]
        for brick in _distinct((self.slot >= 0).nonzero() * BLOCK // size, self.slot.shape).tolist():
            window = self.window(tuple(size * i - before for i in brick), tuple(size * (i + 1) + after for i in brick))
            starts = [size * i - j for i, j in zip(brick, window.low, strict=True)]
            yield window, tuple(slice(i, i + size) for i in starts)


def evaluate(field: SignedDistance, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """Values (n,) of a field at any number of points, a chunk at a time and without a graph."""
    with torch.no_grad():
        if len(points) <= CHUNK:
            return field(points)
        return torch.cat([field(chunk) for chunk in points.split(CHUNK)])


def sample_band(field: SignedDistance, lattice: Lattice, reach: float = 0.0, coarse: int = COARSE) -> Band:
    """Sample a field on a lattice wherever a cell around a point, or between points, can be cut by its zero set.

    Args:
        field: maps points (n, d) to values (n,); any continuous function, not only a distance.
        lattice: where to sample.
        reach: sample as well where the sets can be on which the field takes other values up to this, of either sign.
        coarse: at least so many of the largest blocks lie along the longest edge: fewer take less time, and may miss
            a small component where the field looks flatter than it is.
    """
    far, slope, blocks = _candidates(field, lattice, reach, coarse)
    dim, device = far.ndim, far.device
    typical = float(slope[tuple(blocks.T)].median()) if len(blocks) else 0.0
    # closer to zero than one cell's diagonal, a point may have the surface in its cell
    near = reach + _FINE_SAFETY * lattice.step.norm() * slope
    offsets = _indices((BLOCK,) * dim, device)
    last = torch.tensor(lattice.shape, device=device) - 1
    slot = torch.full(far.shape, -1, dtype=torch.int32, device=device)
    parts: list[Tensor] = []
    count = 0
    while len(blocks):
        points = lattice.points(torch.minimum(blocks[:, None] * BLOCK + offsets, last)).view(-1, dim)
        parts.append(evaluate(field, points).view((len(blocks),) + (BLOCK,) * dim))
        slot[tuple(blocks.T)] = torch.arange(count, count + len(blocks), dtype=torch.int32, device=device)
        count += len(blocks)
        blocks = _reached(blocks, parts[-1], far, slot, near[tuple(blocks.T)])
    values = torch.cat(parts) if parts else far.new_empty((0,) + (BLOCK,) * dim)
    return Band(lattice, far, slot, values, typical if 0 < typical < torch.inf else 1.0)


def _candidates(field: SignedDistance, lattice: Lattice, reach: float, coarse: int) -> tuple[Tensor, Tensor, Tensor]:
    """Which of the smallest blocks can hold the surface.

    Returns:
        The value and the slope measured at or around the middle of every block; and the indices (k, d) of those that
        can hold it.
    """
    size = BLOCK
    while max(lattice.shape) >= 2 * size * coarse:
        size *= 2
    index = _indices(_block_counts(lattice, size), lattice.step.device)
    middles = _middles(lattice, index, size)
    value = evaluate(field, middles)
    steep = _slope_of_all(value, middles, _block_counts(lattice, size))
    known = _spread(torch.stack([value, steep]), _block_counts(lattice, size), size // BLOCK)
    known = known[(slice(None), *(slice(n) for n in _block_counts(lattice, BLOCK)))].contiguous()
    while True:
        # half a block's diagonal to its outermost points, and one more cell around for neighbours
        radius = (size + 1) / 2 * lattice.step.norm()
        kept = value.abs() <= (SAFETY if size > BLOCK else _FINE_SAFETY) * steep * radius + reach
        index, steep = index[kept], steep[kept]
        if size == BLOCK:
            return known[0], known[1], index
        size //= 2
        index, value, steep = _halved(field, lattice, index, steep, size)
        _write(known, index * (size // BLOCK), size // BLOCK, torch.stack([value, steep]))


def _halved(
    field: SignedDistance, lattice: Lattice, index: Tensor, slope: Tensor, size: int
) -> tuple[Tensor, Tensor, Tensor]:
    """The parts of some blocks, of half their edge, ``size``: indices, values and slopes."""
    dim, count = index.shape[1], len(index)
    index = (2 * index[:, None] + _indices((2,) * dim, index.device)).view(-1, dim)
    middles = _middles(lattice, index, size)
    value = evaluate(field, middles)
    cube, squared = (count,) + (2,) * dim, torch.zeros_like(slope)
    for axis in range(dim):
        run = middles[:, axis].view(cube).diff(dim=axis + 1).clamp(min=torch.finfo(middles.dtype).tiny)
        squared += (value.view(cube).diff(dim=axis + 1).abs() / run).flatten(1).amax(1) ** 2
    slope = torch.maximum(slope, squared.sqrt()).repeat_interleave(2**dim)
    there = (index < torch.tensor(_block_counts(lattice, size), device=index.device)).all(1)
    return index[there], value[there], slope[there]


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


def _block_counts(lattice: Lattice, size: int) -> tuple[int, ...]:
    return tuple(-(-n // size) for n in lattice.shape)


def _middles(lattice: Lattice, index: Int[Tensor, "n d"], size: int) -> Float[Tensor, "n d"]:
    """The middles of blocks, within the box: blocks may reach beyond the last points."""
    last = torch.tensor(lattice.shape, device=index.device) - 1
    return lattice.points(torch.minimum(index * size + (size - 1) / 2, last))


def _slope_of_all(value: Tensor, middles: Tensor, shape: tuple[int, ...]) -> Float[Tensor, " n"]:
    """Steepest gradient seen among the neighbours of each block, from differences between middles."""
    coarse = value.view(shape)
    squared = torch.zeros_like(coarse)
    for axis in range(len(shape)):
        run = middles[:, axis].view(shape).diff(dim=axis).clamp(min=torch.finfo(middles.dtype).tiny)
        difference = coarse.diff(dim=axis).abs() / run
        edge = torch.zeros_like(coarse.narrow(axis, 0, 1))
        squared += torch.maximum(torch.cat([difference, edge], axis), torch.cat([edge, difference], axis)) ** 2
    if not bool(squared.any()):  # one block, or a constant: nothing can be excluded
        return torch.full_like(value, torch.inf)
    pool = F.max_pool3d if len(shape) == 3 else F.max_pool2d
    return pool(squared[None, None], 3, stride=1, padding=1)[0, 0].sqrt().flatten()


def _spread(values: Float[Tensor, "m n"], shape: tuple[int, ...], size: int) -> Float[Tensor, "m ..."]:
    """Values at the n blocks of a grid, given to the ``size``^d small ones of each."""
    fine = values.view(-1, *shape)
    for axis in range(len(shape)):
        fine = fine.repeat_interleave(size, axis + 1)
    return fine


def _write(known: Float[Tensor, "m ..."], first: Int[Tensor, "n d"], size: int, values: Float[Tensor, "m n"]) -> None:
    """Give values to the ``size``^d small blocks from ``first`` on, as far as they are there."""
    shape = known.shape[1:]
    for offset in _indices((size,) * len(shape), known.device):
        inner = (first + offset).T
        there = torch.stack([i < n for i, n in zip(inner, shape, strict=True)]).all(0)
        place = tuple(inner[:, there])
        for grid, value in zip(known, values, strict=True):
            grid[place] = value[there]


def _laid_out(blocks: Shaped[Tensor, " *both"]) -> Shaped[Tensor, " *shape"]:
    """Blocks (*blocks, *points) as one grid."""
    dim = blocks.ndim // 2
    order = [axis for pair in zip(range(dim), range(dim, 2 * dim), strict=True) for axis in pair]
    return blocks.permute(order).reshape([BLOCK * n for n in blocks.shape[:dim]])


def _reached(blocks: Tensor, values: Tensor, far: Tensor, slot: Tensor, near: Tensor) -> Int[Tensor, "m d"]:
    """Blocks, not sampled yet, that the surface may enter from some with these values.

    It may where a point on the face between them is near zero (within ``near``, one number a block), or has not the
    sign of the middle of the other block.
    """
    found = [blocks[:0]]
    for axis, forward in product(range(far.ndim), (True, False)):
        face = values.select(axis + 1, BLOCK - 1 if forward else 0).flatten(1)
        beside = blocks.clone()
        beside[:, axis] += 1 if forward else -1
        there = (beside[:, axis] >= 0) & (beside[:, axis] < far.shape[axis])
        there[there.clone()] &= slot[tuple(beside[there].T)] < 0
        face, beside = face[there], beside[there]
        crossed = (face < 0) != (far[tuple(beside.T)] < 0)[:, None]
        found.append(beside[((face.abs() <= near[there, None]) | crossed).any(1)])
    return _distinct(torch.cat(found), far.shape)


def _distinct(index: Int[Tensor, "n d"], shape: tuple[int, ...]) -> Int[Tensor, "m d"]:
    """Each of some indices below ``shape`` once, in order."""
    stride = torch.tensor([prod(shape[axis + 1 :]) for axis in range(len(shape))], device=index.device)
    return torch.stack(torch.unravel_index((index * stride).sum(1).unique(), shape), 1)
