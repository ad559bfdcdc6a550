"""Volume of a morph over time."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.geometry.volume import volume, volume_with_error
from nsm.types import Morph, SignedDistance

#: Volume beyond a box is looked for in one so many times as large, on cells so many times as large.
_LARGER, _COARSER = 1.5, 2


class VolumeCurve(NamedTuple):
    """Volume (area in 2D) inside a morph at some times, the first of which is the reference for deviations.

    Attributes:
        times: (k,).
        volumes: (k,), in units of length to the power d.
        errors: how far each volume may be off (k,), by the estimator's own account; None where nobody asked it.
        growth: volume that is wanted at each time, relative to that at the first (k,); None where none should change.
    """

    times: Float[Tensor, " k"]
    volumes: Float[Tensor, " k"]
    errors: Float[Tensor, " k"] | None = None
    growth: Float[Tensor, " k"] | None = None

    @property
    def wanted(self) -> Float[Tensor, " k"]:
        """The volume that is wanted: V(0), or V(0) times the growth."""
        return self.volumes[0] * (torch.ones_like(self.volumes) if self.growth is None else self.growth)

    @property
    def deviations(self) -> Float[Tensor, " k"]:
        """V(t) over the wanted volume, − 1; not finite where nothing was there at the start."""
        return (self.volumes - self.wanted) / self.wanted

    @property
    def relative_std(self) -> float:
        """Standard deviation over the times (with n − 1) of V over the wanted volume."""
        return float(self.deviations.std())

    @property
    def maximum_deviation(self) -> float:
        """Greatest |V(t) / wanted − 1|."""
        return float(self.deviations.abs().max())

    @property
    def relative_error(self) -> float:
        """Greatest error of the estimator, relative to the wanted volume; not a number where nobody asked it."""
        return float("nan") if self.errors is None else float((self.errors / self.wanted).abs().max())


def volume_beyond(field: SignedDistance, bounds: Float[Tensor, "2 d"], resolution: int) -> float:
    """Volume of {f < 0} next to a box but outside it, within one and a half times its edges.

    Only of interest where the surface leaves the box; what a network holds far from its surface is no shape.

    Args:
        field: f, maps points (n, d) to values (n,), negative inside.
        bounds: Corners of the box, lowest first, shape (2, d).
        resolution: Cells along its longest edge for volumes inside; half as many are taken here.
    """
    middle = bounds.mean(0)
    cells = max(1, resolution // _COARSER)
    larger = volume(field, middle + _LARGER * (bounds - middle), round(_LARGER * cells))
    return max(0.0, larger - volume(field, bounds, cells))


def even_times(count: int = 11) -> Float[Tensor, " k"]:
    """``count`` times from 0 to 1, evenly spaced, in double precision."""
    return torch.arange(count, dtype=torch.double) / max(count - 1, 1)


def volume_curve(morph: Morph, times: Float[Tensor, " k"] | None = None, resolution: int = 96) -> VolumeCurve:
    """Volume of {f(·, t) < 0} within ``morph.bounds``, as `nsm.geometry.volume` measures it, and the error of that.

    Args:
        morph: the morph.
        times: when to measure (k,); 11 times from 0 to 1 by default.
        resolution: cells along the longest edge of the box.
    """
    times = even_times() if times is None else torch.as_tensor(times, dtype=torch.double)
    measured = [volume_with_error(partial(morph, t=t), morph.bounds, resolution) for t in times.tolist()]
    volumes, errors = torch.tensor(measured, dtype=torch.double).unbind(1)
    wanted = torch.tensor([morph.wanted_volume(t) for t in times.tolist()], dtype=torch.double)
    return VolumeCurve(times, volumes, errors, wanted / wanted[0])
