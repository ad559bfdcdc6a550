"""Morph made of moving points, whose shape lies where they are dense."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from scipy.optimize import brentq
from torch import Tensor, nn

from nsm.cli.errors import InputError
from nsm.geometry.differences import finite_gradient
from nsm.geometry.grid import Lattice
from nsm.geometry.volume import volume
from nsm.morphs.optimal_transport.density import REACH, distance_of_density, histogram, kernel_density, padded_lattice
from nsm.shapes import FieldShape
from nsm.types import Morph, Times

#: Number of times whose grids are cached.
_KEPT = 4


class TransportMorph(nn.Module, Morph):
    """Moving shape {f(·, t) < 0} made of points on straight paths.

    Half of the points start uniformly in the source, and half end uniformly in the target. The first half has the mass
    1 − t and the second half the mass t, so that the total mass is 1 at all times and both ends are filled evenly.
    Their density ρ(x, t), smoothed by a Gaussian of width σ, defines

        f(x, t) = −σ Φ⁻¹(ρ(x, t) / ρ₀(t)) − s₀,    ρ₀ = 1 / volume,

    the distance from the surface of a shape of density ρ₀, up to its curvature (`distance_of_density`). A single offset
    s₀, that is, a single threshold of density, applies at all times. It is chosen so that f(·, 0) has the volume of the
    source. More than three kernel widths from the surface f is constant.

    There is no velocity field: the points have velocities, but the surface does not move with them, as it lies where
    their density has a fixed value.

    Args:
        source: Shape at t = 0, posed and scaled.
        target: Shape at t = 1.
        points: Number n of points in each half.
        kernel: σ, in units of length.
        resolution: Cells of the grid of densities along the box.
        volumes: Volumes of the source and the target.

    Attributes:
        bounds: Corners of the box [−1, 1]^d, shape (2, d).
        starts: Points at t = 0, first those of the source, shape (2, n, d).
        stops: Points at t = 1, shape (2, n, d).
        offset: s₀.

    Raises:
        InputError: If the kernel is narrower than the cells of the grid.
    """

    bounds: Tensor
    source: FieldShape
    target: FieldShape
    starts: Tensor
    stops: Tensor
    offset: Tensor

    def __init__(
        self,
        source: FieldShape,
        target: FieldShape,
        points: int,
        kernel: float,
        resolution: int,
        volumes: Sequence[float],
    ) -> None:
        super().__init__()
        self.dim = source.dim
        self.source, self.target = source, target
        self.provenance = {"source": source.provenance(), "target": target.provenance()}
        self.kernel, self.resolution, self.volumes = float(kernel), resolution, tuple(volumes)
        corner = torch.ones(self.dim)
        self.register_buffer("bounds", torch.stack([-corner, corner]))
        self.register_buffer("starts", torch.zeros(2, points, self.dim))
        self.register_buffer("stops", torch.zeros(2, points, self.dim))
        self.register_buffer("offset", torch.zeros(()))
        self._kept: OrderedDict[float, Tensor] = OrderedDict()
        if kernel < float(self.lattice.step.max()):
            raise InputError(
                f"`task.transport.kernel` must be at least the width of a cell, {2 / resolution:.3g}, got {kernel:g}. "
                f"Try `task.transport.resolution={int(2 / kernel) + 1}`."
            )

    @property
    def lattice(self) -> Lattice:
        """Lattice of the densities: the corners of the cells of the box, and a margin around it."""
        return padded_lattice(self.bounds, self.resolution, self.kernel)

    def forward(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"]:
        """Signed distance (n,) at x (n, d) and t; each distinct time needs a grid of its own."""
        return self._each_time(self._value, x, t)

    def gradient(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"]:
        """Spatial gradient (n, d) by differences over two cells of the grid, which are continuous in space."""
        step = float(self.lattice.step.min())
        return self._each_time(lambda p, time: finite_gradient(partial(self._value, t=time), p, step), x, t)

    @torch.no_grad()
    def calibrate(self) -> None:
        """Choose the offset at which the shape at t = 0 has the volume of the source.

        Raises:
            InputError: If no offset gives this volume, because the kernel is too wide or the points are too few.
        """
        self.offset.zero_()

        def excess(level: float) -> float:
            return volume(lambda x: self(x, 0.0) - level, self.bounds, self.resolution) - self.volumes[0]

        reach = (REACH - 1) * self.kernel
        if not excess(-reach) < 0 < excess(reach):
            raise InputError(
                f"`task.transport.kernel` must be narrow enough to show the volume {self.volumes[0]:.3g} of the source "
                f"at some threshold, got {self.kernel:g}. Try `task.transport.kernel={self.kernel / 2:g}`, or more "
                "`task.transport.points`."
            )
        self.offset.fill_(float(brentq(excess, -reach, reach, xtol=1e-3 * self.kernel)))

    def mass(self, t: float) -> Float[Tensor, " *shape"]:
        """Mass at each point of the lattice at time t, which sums to 1."""
        paths = (1 - t) * self.starts + t * self.stops
        shares = torch.tensor([1 - t, t]).to(paths) / paths.shape[1]
        return histogram(paths.flatten(0, 1), shares.repeat_interleave(paths.shape[1]), self.lattice)

    def load_state_dict(self, state_dict: Any, *args: Any, **kwargs: Any) -> Any:
        """Load the points, and clear the grids of the points before."""
        self._kept.clear()
        return super().load_state_dict(state_dict, *args, **kwargs)

    def _apply(self, *args: Any, **kwargs: Any) -> TransportMorph:
        self._kept.clear()  # the grids are on the device where the points were
        return super()._apply(*args, **kwargs)

    def _each_time(self, function: Callable[[Tensor, float], Tensor], x: Tensor, t: Times) -> Tensor:
        if x.ndim != 2 or x.shape[1] != self.dim:
            raise ValueError(f"`x` must have shape (n, {self.dim}), got {tuple(x.shape)}.")
        x, times = x.to(self.bounds), torch.as_tensor(t, dtype=torch.double, device=self.bounds.device)
        if times.ndim == 0:
            return function(x, float(times))
        if times.shape != (len(x),):
            raise ValueError(f"`t` must be one time or have shape ({len(x)},), got {tuple(times.shape)}.")
        out: Tensor | None = None
        for time in times.unique().tolist():
            chosen = times == time
            values = function(x[chosen], time)
            out = values.new_empty(len(x), *values.shape[1:]) if out is None else out
            out[chosen] = values
        return function(x, 0.0) if out is None else out

    def _value(self, x: Tensor, t: float) -> Tensor:
        """Interpolate f linearly between points of the lattice; beyond it, take the value at its boundary."""
        if not len(x):  # grid_sample fails without points
            return x.new_zeros(0)
        lattice = self.lattice
        place = 2 * (x - lattice.origin) / (lattice.step * (torch.tensor(lattice.shape).to(x) - 1)) - 1
        # grid_sample wants the coordinate of the last axis first
        where = place.flip(1).view(1, *[1] * (self.dim - 1), len(x), self.dim)
        values = F.grid_sample(self._grid(t)[None, None], where, padding_mode="border", align_corners=True)
        return values.flatten() - self.offset

    @torch.no_grad()
    def _grid(self, t: float) -> Tensor:
        """Distances on the lattice at one time, cached for the last few times."""
        if t not in self._kept:
            density = kernel_density(self.mass(t), self.lattice, self.kernel)
            # if the target is a scaled source, every shape in between is a scaled source too
            first, last = (v ** (1 / self.dim) for v in self.volumes)
            self._kept[t] = distance_of_density(density * ((1 - t) * first + t * last) ** self.dim, self.kernel)
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(t)
        return self._kept[t]
