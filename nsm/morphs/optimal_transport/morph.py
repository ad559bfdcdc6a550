"""A morph made of moving points: where they are dense, the shape is."""

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
from nsm.geometry.grid import Lattice
from nsm.geometry.volume import volume
from nsm.metrics.endpoint import finite_gradient
from nsm.morphs.optimal_transport.density import REACH, distance_of_density, histogram, kernel_density, padded_lattice
from nsm.shapes import FieldShape
from nsm.types import Morph

#: Times whose grids are kept: the one that is looked at, and its neighbours.
_KEPT = 4


class TransportMorph(nn.Module, Morph):
    """A moving shape {f(·, t) < 0} made of points on straight paths.

    Half of the points start everywhere in the source and half end everywhere in the target. Those of the source have
    together the mass 1 − t and those of the target t, so the mass is 1 at all times and both ends are filled evenly.
    Smoothed by a Gaussian of width σ, their density ρ(x, t) makes

        f(x, t) = −σ Φ⁻¹(ρ(x, t) / ρ₀(t)) − s₀,

    the distance from the surface of a shape of density ρ₀ as far as it is flat (`distance_of_density`), ρ₀ = 1 /
    volume. One s₀, so one threshold of density, holds at all times; it is that which gives f(·, 0) the volume of the
    source. Beyond three kernel widths from the surface f is constant.

    There is no velocity field: the points have velocities, but the surface does not move with them, as it lies where
    their density has a fixed value.

    Args:
        source: the shape at t = 0, posed and scaled.
        target: the shape at t = 1.
        points: how many there are of either half.
        kernel: σ, in units of length.
        resolution: cells of the grid of densities along the box.
        volumes: of source and target.

    Attributes:
        dim: dimension d of space.
        bounds: corners (2, d) of the box [−1, 1]^d, lowest first.
        starts, stops: where the points are at t = 0 and 1 (2, n, d), first those of the source.
        offset: s₀.
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
                f"task.transport.kernel={kernel:g} is narrower than the cells of its grid: give "
                f"task.transport.resolution={int(2 / kernel) + 1} or more, or a wider kernel"
            )

    @property
    def lattice(self) -> Lattice:
        """Where densities are known: the corners of the cells of the box, and some around it."""
        return padded_lattice(self.bounds, self.resolution, self.kernel)

    def forward(self, x: Float[Tensor, "n d"], t: float | Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """Signed distance (n,) at x (n, d) and time t, one number or (n,), each of which takes a grid of its own."""
        return self._each_time(self._value, x, t)

    def gradient(self, x: Float[Tensor, "n d"], t: float | Float[Tensor, " n"]) -> Float[Tensor, "n d"]:
        """Spatial gradient (n, d): differences over two cells of the grid, which are continuous in space."""
        step = float(self.lattice.step.min())
        return self._each_time(lambda p, time: finite_gradient(partial(self._value, t=time), p, step), x, t)

    @torch.no_grad()
    def calibrate(self) -> None:
        """Choose the threshold that gives the shape at t = 0 the volume of the source.

        Raises:
            InputError: if the kernel is too wide, or the points too few, to show that volume at all.
        """
        self.offset.zero_()

        def excess(level: float) -> float:
            return volume(lambda x: self(x, 0.0) - level, self.bounds, self.resolution) - self.volumes[0]

        reach = (REACH - 1) * self.kernel
        if not excess(-reach) < 0 < excess(reach):
            raise InputError(
                f"points smoothed by task.transport.kernel={self.kernel:g} have not the volume {self.volumes[0]:.3g} "
                "of the source at any threshold: give a narrower kernel, or more points"
            )
        self.offset.fill_(float(brentq(excess, -reach, reach, xtol=1e-3 * self.kernel)))

    def mass(self, t: float) -> Float[Tensor, " *shape"]:
        """Mass at each point of the lattice at time t; 1 altogether."""
        paths = (1 - t) * self.starts + t * self.stops
        shares = torch.tensor([1 - t, t]).to(paths) / paths.shape[1]
        return histogram(paths.flatten(0, 1), shares.repeat_interleave(paths.shape[1]), self.lattice)

    def load_state_dict(self, state_dict: Any, *args: Any, **kwargs: Any) -> Any:
        """As any module does; grids of the points before are forgotten."""
        self._kept.clear()
        return super().load_state_dict(state_dict, *args, **kwargs)

    def _apply(self, *args: Any, **kwargs: Any) -> TransportMorph:
        self._kept.clear()  # they lie on the device where the points were
        return super()._apply(*args, **kwargs)

    def _each_time(self, function: Callable[[Tensor, float], Tensor], x: Tensor, t: float | Tensor) -> Tensor:
        if x.ndim != 2 or x.shape[1] != self.dim:
            raise ValueError(f"x has shape {tuple(x.shape)}, but this morph takes points of shape (n, {self.dim})")
        x, times = x.to(self.bounds), torch.as_tensor(t, dtype=torch.double, device=self.bounds.device)
        if times.ndim == 0:
            return function(x, float(times))
        if times.shape != (len(x),):
            raise ValueError(f"t has shape {tuple(times.shape)}, but must be one number or of shape ({len(x)},)")
        out: Tensor | None = None
        for time in times.unique().tolist():
            chosen = times == time
            values = function(x[chosen], time)
            out = values.new_empty(len(x), *values.shape[1:]) if out is None else out
            out[chosen] = values
        return function(x, 0.0) if out is None else out

    def _value(self, x: Tensor, t: float) -> Tensor:
        """f between the points of the lattice, by linear interpolation; beyond it, as at its rim."""
        if not len(x):  # of which grid_sample knows nothing
            return x.new_zeros(0)
        lattice = self.lattice
        place = 2 * (x - lattice.origin) / (lattice.step * (torch.tensor(lattice.shape).to(x) - 1)) - 1
        where = place.flip(1).view(1, *[1] * (self.dim - 1), len(x), self.dim)  # the last axis of the grid comes first
        values = F.grid_sample(self._grid(t)[None, None], where, padding_mode="border", align_corners=True)
        return values.flatten() - self.offset

    @torch.no_grad()
    def _grid(self, t: float) -> Tensor:
        """Distances on the lattice at one time, from the last few if it is there."""
        if t not in self._kept:
            density = kernel_density(self.mass(t), self.lattice, self.kernel)
            # where one shape is the other scaled, so is every shape between them
            first, last = (v ** (1 / self.dim) for v in self.volumes)
            self._kept[t] = distance_of_density(density * ((1 - t) * first + t * last) ** self.dim, self.kernel)
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(t)
        return self._kept[t]
