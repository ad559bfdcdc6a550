"""Regular lattices, and evaluation of fields on them."""

from __future__ import annotations

from math import prod
from typing import NamedTuple

import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor

from nsm.types import SignedDistance

#: Number of points evaluated at once: large enough for efficient matrix products, small enough for the cache.
CHUNK = 1 << 15


class Lattice(NamedTuple):
    """A regular lattice: the points ``origin + step * index`` for all indices below ``shape``.

    Attributes:
        origin: The first point, shape (d,).
        step: Spacing along each axis, shape (d,).
        shape: Number of points along each axis.

    Example:
        >>> import torch
        >>> from nsm.geometry.grid import Lattice
        >>> box = torch.tensor([[0.0, 0.0], [2.0, 1.0]])
        >>> Lattice.centers(box, resolution=4).shape, Lattice.corners(box, resolution=4).shape
        ((4, 2), (5, 3))
    """

    origin: Float[Tensor, " d"]
    step: Float[Tensor, " d"]
    shape: tuple[int, ...]

    @classmethod
    def centers(cls, bounds: Float[Tensor, "2 d"], resolution: int) -> Lattice:
        """Place points at the centers of cells, ``resolution`` of them along the longest edge of the box."""
        step, cells = _cells(bounds, resolution)
        return cls(bounds[0] + step / 2, step, cells)

    @classmethod
    def corners(cls, bounds: Float[Tensor, "2 d"], resolution: int) -> Lattice:
        """Place points at the corners of cells, ``resolution + 1`` of them along the longest edge of the box."""
        step, cells = _cells(bounds, resolution)
        return cls(bounds[0], step, tuple(n + 1 for n in cells))

    def points(self, index: Shaped[Tensor, "*n d"]) -> Float[Tensor, "*n d"]:
        """Compute the points at indices of shape (..., d), which may be fractional."""
        return self.origin + self.step * index

    def indices(self) -> Int[Tensor, "n d"]:
        """List the indices of all points, shape (n, d), the last axis fastest."""
        return index_grid(self.shape, self.step.device)


def evaluate(field: SignedDistance, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """Evaluate a field at points, shape (n, d), in chunks of `CHUNK` and without a graph; returns shape (n,)."""
    with torch.no_grad():
        if len(points) <= CHUNK:
            return field(points)
        return torch.cat([field(chunk) for chunk in points.split(CHUNK)])


def index_grid(shape: tuple[int, ...], device: torch.device) -> Int[Tensor, "n d"]:
    """List all indices below ``shape``, shape (n, d), the last axis fastest."""
    axes = [torch.arange(n, device=device) for n in shape]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).view(prod(shape), len(shape))


def _cells(bounds: Tensor, resolution: int) -> tuple[Tensor, tuple[int, ...]]:
    extent = bounds[1] - bounds[0]
    if resolution < 1 or not bool((extent > 0).all()):
        raise ValueError(
            "`resolution` must be at least 1 and `bounds` must be a box with positive edges, got "
            f"resolution={resolution} and bounds={bounds.tolist()}. Try `resolution=64` and "
            "`bounds=torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])`."
        )
    counts = (resolution * extent / extent.max()).round().clamp(min=1)
    return extent / counts, tuple(int(n) for n in counts)
