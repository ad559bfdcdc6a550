"""Flow maps of a velocity field over a box: the positions of all points at t = 0 and t = 1."""

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

#: Default number of Runge-Kutta steps per unit of time through the table of velocities.
STEPS = 8
#: Maximum number of cached flow maps, one per time: metrics evaluate a time and its neighbors repeatedly.
_CACHE_SIZE = 32
#: Refinement factor of the lattice on which velocities are interpolated linearly.
_REFINEMENT = 2


class FlowError(NamedTuple):
    """Deviation of flow maps, and of fields advected with them, from direct integration of V.

    Attributes:
        mean: Mean distance between points advected by the flow maps and by direct integration.
        maximum: Maximum of that distance.
        field: Mean difference of the signed distance to which advected detail was added.
    """

    mean: float
    maximum: float
    field: float


class FlowMaps:
    """The flow φ of a velocity field V from any time to both ends, computed once per time.

    φ_{t→s}(x) is the position at time s of the point that is at x at time t. V is sampled once on a lattice over the
    box at Chebyshev times; between them it is a polynomial in time and a cubic spline in space. The points of the
    lattice are advected through this table (`RungeKutta`) without further evaluations of V, and an `Interpolant`
    interpolates their displacements φ(x) − x. The error of φ decreases towards the end s and vanishes there.

    Outside the box V is extended by its value at the nearest point of the box.

    Args:
        velocity: The velocity V, which maps points, shape (n, d), and one time to velocities, shape (n, d).
        bounds: Corners of the box, shape (2, d).
        resolution: Number of cells of the lattice along the longest edge of the box.
        slices: Number of times in [0, 1] at which V is sampled, at least 2.
        steps: Number of Runge-Kutta steps per unit of time.
    """

    def __init__(
        self, velocity: VelocityField, bounds: Float[Tensor, "2 d"], resolution: int, slices: int, steps: int = STEPS
    ) -> None:
        self.method = RungeKutta(steps)
        self.lattice = Lattice.corners(bounds, resolution)
        self._nodes = self.lattice.points(self.lattice.indices())
        self._times = (1 - np.cos(np.pi * np.arange(slices) / (slices - 1))) / 2
        self._table = _Table(velocity, self.lattice, self._nodes, self._times)
        self._cache: OrderedDict[float, Interpolant] = OrderedDict()

    def at(self, t: float) -> Interpolant:
        """Interpolate the displacements from a time to both ends.

        Args:
            t: Time in [0, 1].

        Returns:
            An interpolant with 2 d columns, φ_{t→0}(x) − x followed by φ_{t→1}(x) − x.
        """
        if t not in self._cache:
            displacements = [self._advected(t, end) - self._nodes for end in (0.0, 1.0)]
            self._cache[t] = Interpolant(self.lattice, torch.cat(displacements, 1))
            if len(self._cache) > _CACHE_SIZE:
                self._cache.popitem(last=False)
        self._cache.move_to_end(t)
        return self._cache[t]

    def _advected(self, start: float, end: float) -> Float[Tensor, "n d"]:
        """Advect all points of the lattice together, so that each stage interpolates the table in time only once."""
        x = self._nodes
        for before, after in pairwise(self.method.stops(start, end)):
            x = self.method.advance(self._table, x, before, after)
        return x


class _Table:
    """A velocity field interpolated from samples on a lattice at Chebyshev times."""

    def __init__(self, velocity: VelocityField, lattice: Lattice, nodes: Tensor, times: np.ndarray) -> None:
        dim = nodes.shape[1]
        self.times, self.signs = times, (-1.0) ** np.arange(len(times))
        self.signs[[0, -1]] /= 2  # barycentric weights of Chebyshev points of the second kind
        self.low, self.extent = lattice.origin, lattice.step * (nodes.new_tensor(lattice.shape) - 1)
        refinements = [_spline_refinement(count).to(nodes) for count in lattice.shape]
        slices = []
        with torch.no_grad():
            for time in times.tolist():
                values = torch.cat([velocity(chunk, time).to(nodes) for chunk in nodes.split(CHUNK)])
                grid = values.T.reshape(dim, *lattice.shape)
                for axis, matrix in enumerate(refinements, 1):
                    grid = torch.tensordot(grid, matrix, ([axis], [1])).movedim(-1, axis)
                slices.append(grid)
        self.slices = torch.stack(slices)

    def __call__(self, x: Float[Tensor, "n d"], t: float) -> Float[Tensor, "n d"]:
        """Interpolate velocities at points, shape (n, d), and one time."""
        away = t - self.times
        if (away == 0).any():
            weights = (away == 0).astype(float)
        else:
            weights = self.signs / away
            weights /= weights.sum()
        grid = torch.tensordot(self.slices.new_tensor(weights), self.slices, 1)[None]
        # grid_sample expects coordinates from the last axis to the first
        coordinates = (2 * (x - self.low) / self.extent - 1).flip(1)
        shaped = coordinates.view(1, len(x), *[1] * (x.shape[1] - 1), x.shape[1])
        return F.grid_sample(grid, shaped, align_corners=True, padding_mode="border").view(x.shape[1], len(x)).T


def _spline_refinement(count: int) -> Float[Tensor, "m n"]:
    """Build the matrix that evaluates the cubic spline through ``count`` uniform samples on a refined grid."""
    positions = np.arange(count, dtype=float)
    refined = np.linspace(0, count - 1, _REFINEMENT * (count - 1) + 1)
    return torch.from_numpy(CubicSpline(positions, np.eye(count))(refined))
