"""Sampling of a field on a lattice, but only in a band around its zero level set.

A surface meets only a fraction O(1/r) of the r^d points of a lattice. The lattice is therefore divided into blocks. The
field is evaluated at the center of each block, and blocks that may contain the surface are halved recursively down to
small blocks, which are sampled in full. A block with center c and radius R contains no zero if |f(c)| > L R, where L
bounds the slope of f nearby. L is 1.5 times the largest slope measured among neighboring blocks, and again among the
parts of each halved block. Where that is a bound, no component is missed, however small or isolated: of a distance,
even a ball smaller than a cell is found. If L is too small and the surface reaches the boundary of the sampled blocks,
their neighbors are sampled as well, repeatedly. At worst, whole components are missed that lie between large blocks
where f appears flatter than it is.

Only sampled blocks are stored, so memory is proportional to the area of the surface.
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

from nsm.geometry.grid import Lattice, evaluate, index_grid
from nsm.types import SignedDistance

#: Number of points along an edge of the smallest blocks, which are sampled in full.
BLOCK = 2
#: Default for the minimum number of the largest blocks along the longest edge.
COARSE = 32
#: Safety factor for the measured slope, which is a maximum over few samples.
_SAFETY = 1.5
#: Safety factor among the smallest blocks, whose neighbors are sampled as well if necessary.
_FINE_SAFETY = 1.1
#: Number of points along an edge of a brick, the unit that is expanded to a full grid, by dimension.
_BRICK = {2: 256, 3: 32}


class Window(NamedTuple):
    """A rectangular part of a lattice.

    Attributes:
        low: Index of its first point.
        values: Values of the field where ``known``; elsewhere values with the correct sign.
        known: Whether a point was sampled.
    """

    low: tuple[int, ...]
    values: Float[Tensor, " *shape"]
    known: Bool[Tensor, " *shape"]


class Band(NamedTuple):
    """Values of a field on a lattice near its zero level set.

    Attributes:
        lattice: The full lattice.
        far: One value with the correct sign for each block, bounded away from zero where the block is not sampled.
        slot: Row of each block in ``values``, or −1 where it is not sampled.
        values: Values of the sampled blocks, ``BLOCK`` points along each edge, repeated beyond the end of the lattice.
        slope: Typical ‖∇f‖ near the zero level set, 1 for a distance.
    """

    lattice: Lattice
    far: Float[Tensor, " *blocks"]
    slot: Int[Tensor, " *blocks"]
    values: Float[Tensor, " k *block"]
    slope: float

    def window(self, low: tuple[int, ...], high: tuple[int, ...]) -> Window:
        """Expand the points with indices from ``low`` to below ``high``, clipped to the lattice."""
        low = tuple(max(i, 0) for i in low)
        high = tuple(min(i, n) for i, n in zip(high, self.lattice.shape, strict=True))
        dim, first = len(low), [i // BLOCK for i in low]
        blocks = tuple(slice(i, -(-j // BLOCK)) for i, j in zip(first, high, strict=True))
        slot = self.slot[blocks]
        known = (slot >= 0)[(...,) + (None,) * dim].expand(slot.shape + (BLOCK,) * dim)
        values = self.far[blocks][(...,) + (None,) * dim].expand(known.shape).clone()
        values[slot >= 0] = self.values[slot[slot >= 0]]
        inner = tuple(slice(i - BLOCK * b, j - BLOCK * b) for i, j, b in zip(low, high, first, strict=True))
        return Window(low, _join_blocks(values)[inner], _join_blocks(known)[inner])

    def whole(self) -> Window:
        """Expand all points of the lattice."""
        return self.window((0,) * len(self.lattice.shape), self.lattice.shape)

    def bricks(self, before: int = 0, after: int = 0) -> Iterator[tuple[Window, tuple[slice, ...]]]:
        """Iterate over disjoint bricks of equal size that together contain all sampled points.

        Args:
            before, after: Number of additional points around a brick, toward lower and higher indices.

        Yields:
            The window of a brick with the additional points, and the slices of the brick in it.
        """
        size = _BRICK[len(self.lattice.shape)]
        for brick in _distinct((self.slot >= 0).nonzero() * BLOCK // size, self.slot.shape).tolist():
            window = self.window(tuple(size * i - before for i in brick), tuple(size * (i + 1) + after for i in brick))
            starts = [size * i - j for i, j in zip(brick, window.low, strict=True)]
            yield window, tuple(slice(i, i + size) for i in starts)


def sample_band(field: SignedDistance, lattice: Lattice, reach: float = 0.0, coarse: int = COARSE) -> Band:
    """Sample a field on a lattice wherever its zero level set may cut a cell around a point, or between points.

    Args:
        field: A continuous function that maps points, shape (n, d), to values, shape (n,); not only a distance.
        lattice: The lattice.
        reach: Largest absolute value of other levels whose sets are sampled as well.
        coarse: Minimum number of the largest blocks along the longest edge. Fewer blocks take less time, but may miss
            a small component where the field appears flatter than it is.
    """
    far, slope, blocks = _candidates(field, lattice, reach, coarse)
    dim, device = far.ndim, far.device
    typical = float(slope[tuple(blocks.T)].median()) if len(blocks) else 0.0
    # the surface may pass through the cell of a point whose value is less than the diagonal of a cell times the slope
    near = reach + _FINE_SAFETY * lattice.step.norm() * slope
    offsets = index_grid((BLOCK,) * dim, device)
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
    """Find the smallest blocks that may contain the surface.

    Returns:
        Value and measured slope of every block, and the indices of candidates, shape (k, d).
    """
    size = BLOCK
    while max(lattice.shape) >= 2 * size * coarse:
        size *= 2
    index = index_grid(_block_counts(lattice, size), lattice.step.device)
    centers = _centers(lattice, index, size)
    value = evaluate(field, centers)
    steep = _slope_of_all(value, centers, _block_counts(lattice, size))
    known = _spread(torch.stack([value, steep]), _block_counts(lattice, size), size // BLOCK)
    known = known[(slice(None), *(slice(n) for n in _block_counts(lattice, BLOCK)))].contiguous()
    while True:
        # half the diagonal of a block, including one more cell for its neighbors
        radius = (size + 1) / 2 * lattice.step.norm()
        kept = value.abs() <= (_SAFETY if size > BLOCK else _FINE_SAFETY) * steep * radius + reach
        index, steep = index[kept], steep[kept]
        if size == BLOCK:
            return known[0], known[1], index
        size //= 2
        index, value, steep = _halved(field, lattice, index, steep, size)
        _write(known, index * (size // BLOCK), size // BLOCK, torch.stack([value, steep]))


def _halved(
    field: SignedDistance, lattice: Lattice, index: Tensor, slope: Tensor, size: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Halve blocks to the edge ``size``, and return indices, values, and slopes of the parts."""
    dim, count = index.shape[1], len(index)
    index = (2 * index[:, None] + index_grid((2,) * dim, index.device)).view(-1, dim)
    centers = _centers(lattice, index, size)
    value = evaluate(field, centers)
    cube, squared = (count,) + (2,) * dim, torch.zeros_like(slope)
    for axis in range(dim):
        run = centers[:, axis].view(cube).diff(dim=axis + 1).clamp(min=torch.finfo(centers.dtype).tiny)
        squared += (value.view(cube).diff(dim=axis + 1).abs() / run).flatten(1).amax(1) ** 2
    slope = torch.maximum(slope, squared.sqrt()).repeat_interleave(2**dim)
    there = (index < torch.tensor(_block_counts(lattice, size), device=index.device)).all(1)
    return index[there], value[there], slope[there]


def _block_counts(lattice: Lattice, size: int) -> tuple[int, ...]:
    return tuple(-(-n // size) for n in lattice.shape)


def _centers(lattice: Lattice, index: Int[Tensor, "n d"], size: int) -> Float[Tensor, "n d"]:
    """Compute the centers of blocks, clipped to the lattice because the last blocks may extend beyond it."""
    last = torch.tensor(lattice.shape, device=index.device) - 1
    return lattice.points(torch.minimum(index * size + (size - 1) / 2, last))


def _slope_of_all(value: Tensor, centers: Tensor, shape: tuple[int, ...]) -> Float[Tensor, " n"]:
    """Measure the largest slope around each block from differences between the centers of neighbors."""
    coarse = value.view(shape)
    squared = torch.zeros_like(coarse)
    for axis in range(len(shape)):
        run = centers[:, axis].view(shape).diff(dim=axis).clamp(min=torch.finfo(centers.dtype).tiny)
        difference = coarse.diff(dim=axis).abs() / run
        edge = torch.zeros_like(coarse.narrow(axis, 0, 1))
        squared += torch.maximum(torch.cat([difference, edge], axis), torch.cat([edge, difference], axis)) ** 2
    if not bool(squared.any()):  # a single block, or a constant: no block can be excluded
        return torch.full_like(value, torch.inf)
    pool = F.max_pool3d if len(shape) == 3 else F.max_pool2d
    return pool(squared[None, None], 3, stride=1, padding=1)[0, 0].sqrt().flatten()


def _spread(values: Float[Tensor, "m n"], shape: tuple[int, ...], size: int) -> Float[Tensor, "m ..."]:
    """Repeat the values of n blocks for the ``size``^d small blocks of each."""
    fine = values.view(-1, *shape)
    for axis in range(len(shape)):
        fine = fine.repeat_interleave(size, axis + 1)
    return fine


def _write(known: Float[Tensor, "m ..."], first: Int[Tensor, "n d"], size: int, values: Float[Tensor, "m n"]) -> None:
    """Write values to the ``size``^d small blocks starting at ``first``, as far as they exist."""
    shape = known.shape[1:]
    for offset in index_grid((size,) * len(shape), known.device):
        inner = (first + offset).T
        there = torch.stack([i < n for i, n in zip(inner, shape, strict=True)]).all(0)
        place = tuple(inner[:, there])
        for grid, value in zip(known, values, strict=True):
            grid[place] = value[there]


def _join_blocks(blocks: Shaped[Tensor, " *both"]) -> Shaped[Tensor, " *shape"]:
    """Arrange blocks, shape (*blocks, *points), as one grid."""
    dim = blocks.ndim // 2
    order = [axis for pair in zip(range(dim), range(dim, 2 * dim), strict=True) for axis in pair]
    return blocks.permute(order).reshape([BLOCK * n for n in blocks.shape[:dim]])


def _reached(blocks: Tensor, values: Tensor, far: Tensor, slot: Tensor, near: Tensor) -> Int[Tensor, "m d"]:
    """Find blocks, not sampled yet, that the surface may enter from sampled ones.

    It may enter where a value on the common face is within ``near`` of zero, one bound for each block, or differs in
    sign from the center of the other block.
    """
    found = [blocks[:0]]
    for axis, forward in product(range(far.ndim), (True, False)):
        face = values.select(axis + 1, BLOCK - 1 if forward else 0).flatten(1)
        other = blocks.clone()
        other[:, axis] += 1 if forward else -1
        there = (other[:, axis] >= 0) & (other[:, axis] < far.shape[axis])
        there[there.clone()] &= slot[tuple(other[there].T)] < 0
        face, other = face[there], other[there]
        crossed = (face < 0) != (far[tuple(other.T)] < 0)[:, None]
        found.append(other[((face.abs() <= near[there, None]) | crossed).any(1)])
    return _distinct(torch.cat(found), far.shape)


def _distinct(index: Int[Tensor, "n d"], shape: tuple[int, ...]) -> Int[Tensor, "m d"]:
    """Sort indices below ``shape`` and remove duplicates."""
    stride = torch.tensor([prod(shape[axis + 1 :]) for axis in range(len(shape))], device=index.device)
    return torch.stack(torch.unravel_index((index * stride).sum(1).unique(), shape), 1)
