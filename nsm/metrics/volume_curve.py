"""Volume of a morph over time."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.geometry.volume import volume
from nsm.types import Morph


class VolumeCurve(NamedTuple):
    """Volume (area in 2D) inside a morph at some times, the first of which is the reference for deviations."""

    times: Float[Tensor, " k"]
    volumes: Float[Tensor, " k"]

    @property
    def deviations(self) -> Float[Tensor, " k"]:
        """V(t) / V(0) - 1; infinite where nothing was there at the start."""
        return (self.volumes - self.volumes[0]) / self.volumes[0]

    @property
    def relative_std(self) -> float:
        """Standard deviation of V over the times (with n - 1), divided by V(0)."""
        return float(self.volumes.std() / self.volumes[0])

    @property
    def maximum_deviation(self) -> float:
        """Greatest |V(t) / V(0) - 1|."""
        return float(self.deviations.abs().max())


def even_times(count: int = 11) -> Float[Tensor, " k"]:
    """``count`` times from 0 to 1, evenly spaced, in double precision."""
    return torch.arange(count, dtype=torch.double) / max(count - 1, 1)


def volume_curve(morph: Morph, times: Float[Tensor, " k"] | None = None, resolution: int = 96) -> VolumeCurve:
    """Volume of {f(·, t) < 0} within ``morph.bounds``, as `nsm.geometry.volume` measures it.

    Args:
        morph: the morph.
        times: when to measure (k,); 11 times from 0 to 1 by default.
        resolution: cells along the longest edge of the box.
    """
    times = even_times() if times is None else torch.as_tensor(times, dtype=torch.double)
    volumes = [volume(partial(morph, t=t), morph.bounds, resolution) for t in times.tolist()]
    return VolumeCurve(times, torch.tensor(volumes, dtype=torch.double))
