"""Flow maps of a velocity field over a box: where every point comes from at t = 0 and goes to at t = 1."""

from __future__ import annotations

from collections import OrderedDict
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from torch import Tensor

from nsm.geometry.advection import RungeKutta, VelocityField
from nsm.geometry.grid import CHUNK, Lattice
from nsm.geometry.interpolation import Interpolant

#: Runge-Kutta steps in a unit of time through the table of velocities.
STEPS = 8
#: Flow maps that are kept, one for each time: metrics ask for a time and its neighbors, over and over.
_KEPT = 32
#: Points of the finer lattice from which velocities are read linearly, for each cell of the table.
_FINER = 2


class FlowError(NamedTuple):
    """Deviation of flow maps, and of what is carried by them, from direct integration of V.

    Attributes:
        mean: Mean distance between points carried by the flow maps and by direct integration.
        maximum: Greatest such distance.
        field: Mean difference of the signed distance to which carried detail was added.
    """

    mean: float
    maximum: float
    field: float


class FlowMaps:
    """The flow φ of a velocity field V from any time to both ends, computed once for each time.

    φ_{t→s}(x) is where the point that is at x at time t is at time s. V is sampled once on a lattice over the box, at
    Chebyshev times; between those it is a polynomial in time and a cubic spline in space. The points of the lattice are
    then carried through that table (`RungeKutta`), which asks nothing of V, and their displacements φ(x) − x are
    interpolated by `Interpolant`. So the error of φ falls with the distance to the end, and vanishes there.

    Beyond the box V is taken to be what it is at the nearest point of it.

    Args:
        velocity: V(x, t), shape (n, d), at points (n, d) and one time.
        bounds: Corners of the box, shape (2, d).
        resolution: Cells of the lattice along the longest edge of the box.
        slices: Times in [0, 1] at which V is sampled, at least 2.
        steps: Runge-Kutta steps in a unit of time.
    """

    def __init__(
        self, velocity: VelocityField, bounds: Float[Tensor, "2 d"], resolution: int, slices: int, steps: int = STEPS
    ) -> None:
        self.steps = RungeKutta(steps)
        self.lattice = Lattice.corners(bounds, resolution)
        self._nodes = self.lattice.points(self.lattice.indices())
        self._times = (1 - np.cos(np.pi * np.arange(slices) / (slices - 1))) / 2
        self._table = _Table(velocity, self.lattice, self._nodes, self._times)
        self._kept: OrderedDict[float, Interpolant] = OrderedDict()

    def at(self, t: float) -> Interpolant:
        """The displacements from a time to both ends.

        Args:
            t: A time in [0, 1].

        Returns:
            Interpolant of 2 d columns: φ_{t→0}(x) − x, then φ_{t→1}(x) − x.
        """
        if t not in self._kept:
            moved = [self._carried(t, end) - self._nodes for end in (0.0, 1.0)]
            self._kept[t] = Interpolant(self.lattice, torch.cat(moved, 1))
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(t)
        return self._kept[t]

    def _carried(self, start: float, end: float) -> Tensor:
        """Positions of the points of the lattice, all of them at once: they share the table of each stage."""
        x = self._nodes
        for before, after in pairwise(self.steps.stops(start, end, projected=False)):
            x = self.steps.advance(self._table, x, before, after)
        return x


class _Table:
    """A velocity field read from samples on a lattice at some times."""

    def __init__(self, velocity: VelocityField, lattice: Lattice, nodes: Tensor, times: np.ndarray) -> None:
        dim = nodes.shape[1]
        self.times, self.signs = times, (-1.0) ** np.arange(len(times))
        self.signs[[0, -1]] /= 2  # barycentric weights of Chebyshev points of the second kind
        self.low, self.extent = lattice.origin, lattice.step * (nodes.new_tensor(lattice.shape) - 1)
        finer = [_refining(count).to(nodes) for count in lattice.shape]
        slices = []
        with torch.no_grad():
            for time in times.tolist():
                values = torch.cat([velocity(chunk, time).to(nodes) for chunk in nodes.split(CHUNK)])
                grid = values.T.reshape(dim, *lattice.shape)
                for axis, matrix in enumerate(finer, 1):
                    grid = torch.tensordot(grid, matrix, ([axis], [1])).movedim(-1, axis)
                slices.append(grid)
        self.slices = torch.stack(slices)

    def __call__(self, x: Float[Tensor, "n d"], t: float) -> Float[Tensor, "n d"]:
        """Velocities at points and one time."""
        away = t - self.times
        if (away == 0).any():
            weights = (away == 0).astype(float)
        else:
            weights = self.signs / away
            weights /= weights.sum()
        grid = torch.tensordot(self.slices.new_tensor(weights), self.slices, 1)[None]
        place = (2 * (x - self.low) / self.extent - 1).flip(1)  # the last axis of a grid comes first
        shaped = place.view(1, len(x), *[1] * (x.shape[1] - 1), x.shape[1])
        return F.grid_sample(grid, shaped, align_corners=True, padding_mode="border").view(x.shape[1], len(x)).T


def _refining(count: int) -> Tensor:
    """The matrix that takes values at ``count`` even places to those of their cubic spline at more of them."""
    places = np.arange(count, dtype=float)
    finer = np.linspace(0, count - 1, _FINER * (count - 1) + 1)
    return torch.from_numpy(CubicSpline(places, np.eye(count))(finer))
