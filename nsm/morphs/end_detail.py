"""Detail that a morph lacks at one of its ends: the difference between the shape and f, as a function of position."""

from __future__ import annotations

import math
from functools import cached_property, partial

import torch
from torch import Tensor

from nsm.geometry.grid import Lattice, evaluate
from nsm.geometry.interpolation import Interpolant
from nsm.shapes.gradient import shape_gradient
from nsm.types import Morph, SignedDistance

#: Distance from the surfaces of an end at which its tabulated difference has faded to 0, relative to the box, and its
#: minimum in cells of the table.
REACH, _REACH_CELLS = 0.03, 3.0
#: Interval of time next to an end in which the shape itself, with detail finer than the lattice, gives the difference.
NEAR = 0.04
#: Lattice points along the edges of the first blocks, which are halved or discarded until they are single points.
_BLOCK = 8
#: Upper bound of the slope of signed distances, by which blocks are discarded.
_SLOPE = 1.2


class EndDetail:
    """Difference h = g − f(·, time) at an end, and its table H, which is 0 away from both surfaces.

    Args:
        morph: f.
        time: Time of the end, 0 or 1.
        shape: Shape g at that end.
        resolution: Cells of the table along the box.
    """

    def __init__(self, morph: Morph, time: float, shape: SignedDistance, resolution: int) -> None:
        self.morph, self.time, self.shape, self.resolution = morph, time, shape, resolution

    def weight(self, t: Tensor) -> Tensor:
        """cos²(πt/2) for the source, sin²(πt/2) for the target."""
        return (torch.pi / 2 * (t - self.time)).cos().square()

    def share(self, t: Tensor) -> Tensor:
        """Share of that weight which applies to h itself, the rest to H: 1 at the end, 0 beyond `NEAR`."""
        return (1 - ((t - self.time) / NEAR).square()).clamp(min=0) ** 3

    def value(self, y: Tensor, t: Tensor) -> Tensor:
        """Term of this end (n,) for points whose position at the end is y (n, d)."""
        share = self.share(t)
        value = (self.weight(t) - share) * self.table(y)[:, 0]
        near = (share > 0).expand(len(y))
        if near.any():
            fine = share.expand(len(y))[near] * self.difference(y[near])
            value = value + torch.zeros_like(value).masked_scatter(near, fine)
        return value

    def gradient(self, y: Tensor, t: Tensor, step: float) -> Tensor:
        """Gradient of `value` with respect to y, shape (n, d)."""
        share = self.share(t)
        gradient = (self.weight(t) - share).view(-1, 1) * self.table.jet(y)[1][:, 0]
        near = (share > 0).expand(len(y))
        if near.any():
            slope = shape_gradient(self.shape, y[near], step) - self.morph.gradient(y[near], self.time)
            gradient[near] += share.expand(len(y))[near, None] * slope
        return gradient

    def difference(self, y: Tensor) -> Tensor:
        """h at points y (n, d), shape (n,)."""
        return self.shape(y) - self.morph(y, self.time)

    @property
    def reach(self) -> float:
        """Distance from both surfaces beyond which H is 0."""
        edge = float((self.morph.bounds[1] - self.morph.bounds[0]).max())
        return max(REACH * edge, _REACH_CELLS * edge / self.resolution)

    @cached_property
    def table(self) -> Interpolant:
        """H, sampled near the surfaces of g and f(·, time), and between them."""
        lattice, reach = Lattice.corners(self.morph.bounds, self.resolution), self.reach
        last = torch.tensor(lattice.shape, device=lattice.step.device) - 1
        size, index = _BLOCK, lattice._replace(shape=tuple(-(-n // _BLOCK) for n in lattice.shape)).indices()
        while True:
            middles = lattice.points(torch.minimum(index * size + (size - 1) / 2, last))
            apart, difference = self._sampled(middles)
            if size == 1:
                break
            index = index[apart <= reach + _SLOPE * (size - 1) / 2 * float(lattice.step.norm())]
            size //= 2
            halves = lattice._replace(shape=(2,) * self.morph.dim).indices()
            index = (2 * index[:, None] + halves).view(-1, self.morph.dim)
            index = index[(index * size <= last).all(1)]
        stride = [math.prod(lattice.shape[axis + 1 :]) for axis in range(self.morph.dim)]
        values = difference.new_zeros(math.prod(lattice.shape), 1)
        values[(index * torch.tensor(stride, device=index.device)).sum(1), 0] = _fade(apart / reach) * difference
        return Interpolant(lattice, values)

    def _sampled(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Distance of points from both surfaces, which is 0 between them, and h there."""
        shape, network = evaluate(self.shape, x), evaluate(partial(self.morph, t=self.time), x)
        apart = torch.maximum(torch.minimum(shape, network), -torch.maximum(shape, network)).clamp(min=0)
        return apart, shape - network


def _fade(distance: Tensor) -> Tensor:
    """Twice continuously differentiable step that is 1 up to a third and 0 from 1 on."""
    u = (1.5 * distance - 0.5).clamp(0, 1)
    return 1 - u * u * u * (10 - 15 * u + 6 * u * u)
