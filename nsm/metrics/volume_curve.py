"""Volume of a morph over time, and its deviation from the wanted volume."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.geometry.volume import VOLUME_RESOLUTION, volume, volume_with_error
from nsm.types import Morph, SignedDistance

#: Factor by which a box is enlarged to find volume beyond it, and by which the cells are larger there.
_LARGER, _COARSER = 1.5, 2
#: Times closer than this are one.
_SAME_TIME = 1e-6


class VolumeCurve(NamedTuple):
    """Volume (area in 2D) inside a morph over time, compared with the volume at the first time.

    Attributes:
        times: Times, shape (k,).
        volumes: Volumes in units of length to the power d, shape (k,).
        errors: Estimated error of each volume, shape (k,); None where it was not estimated.
        growth: Wanted volume at each time relative to that at the first, shape (k,); None where it is constant.
    """

    times: Float[Tensor, " k"]
    volumes: Float[Tensor, " k"]
    errors: Float[Tensor, " k"] | None = None
    growth: Float[Tensor, " k"] | None = None

    @property
    def wanted(self) -> Float[Tensor, " k"]:
        """Wanted volume: V(0) times the growth."""
        return self.volumes[0] * (torch.ones_like(self.volumes) if self.growth is None else self.growth)

    @property
    def deviations(self) -> Float[Tensor, " k"]:
        """Relative deviation, V(t) / wanted volume − 1; not finite where V(0) is 0."""
        return (self.volumes - self.wanted) / self.wanted

    @property
    def relative_std(self) -> float:
        """Sample standard deviation over the times of V(t) / wanted volume."""
        return float(self.deviations.std())

    @property
    def maximum_deviation(self) -> float:
        """Greatest |V(t) / wanted volume − 1|."""
        return float(self.deviations.abs().max())

    @property
    def relative_error(self) -> float:
        """Greatest estimated error relative to the wanted volume; nan where errors were not estimated."""
        return float("nan") if self.errors is None else float((self.errors / self.wanted).abs().max())


def volume_beyond(field: SignedDistance, bounds: Float[Tensor, "2 d"], resolution: int) -> float:
    """Volume of {f < 0} outside a box but inside the box of 1.5 times its size around the same center.

    It is meaningful only where the surface leaves the box, since the values of a network far from its surface are not.

    Args:
        field: Signed distance f, maps points (n, d) to values (n,), negative inside.
        bounds: Corners of the box, lowest first, shape (2, d).
        resolution: Cells along the longest edge of the box for volumes inside it; half as many are used here.
    """
    middle = bounds.mean(0)
    cells = max(1, resolution // _COARSER)
    larger = volume(field, middle + _LARGER * (bounds - middle), round(_LARGER * cells))
    return max(0.0, larger - volume(field, bounds, cells))


def even_times(count: int = 11) -> Float[Tensor, " k"]:
    """Evenly spaced times from 0 to 1 in double precision, shape (k,).

    >>> even_times(5).tolist()
    [0.0, 0.25, 0.5, 0.75, 1.0]
    """
    return torch.arange(count, dtype=torch.double) / max(count - 1, 1)


def times_through(morph: Morph, count: int = 11) -> Float[Tensor, " k"]:
    """Evenly spaced times from 0 to 1 and those of the morph's keys, in increasing order, shape (k,).

    Args:
        morph: Morph.
        count: Number of evenly spaced times.
    """
    return torch.tensor(with_key_times(morph, even_times(count).tolist()), dtype=torch.double)


def with_key_times(morph: Morph, times: Iterable[float]) -> list[float]:
    """Some times and those of the morph's keys, in increasing order, each once."""
    found = list(times)
    found += [key.time for key in morph.keys if all(abs(key.time - time) > _SAME_TIME for time in found)]
    return sorted(found)


def volume_curve(
    morph: Morph, times: Float[Tensor, " k"] | None = None, resolution: int = VOLUME_RESOLUTION
) -> VolumeCurve:
    """Measure the volume of {f(·, t) < 0} within ``morph.bounds`` over time (`nsm.geometry.volume`).

    Args:
        morph: Morph to measure.
        times: Times, shape (k,); by default 11 times from 0 to 1.
        resolution: Cells along the longest edge of the box.

    Returns:
        Volumes, their estimated errors, and the wanted growth.

    Example:
        A disk of radius 0.5 − 0.1 t loses 36 % of its area.

        >>> class Shrinking(Morph):
        ...     dim, bounds = 2, torch.tensor([[-1.0, -1.0], [1.0, 1.0]])
        ...     def __call__(self, x, t):
        ...         return x.norm(dim=1) - 0.5 + 0.1 * t
        ...     def gradient(self, x, t):
        ...         return x / x.norm(dim=1, keepdim=True)
        >>> curve = volume_curve(Shrinking(), torch.tensor([0.0, 1.0]))
        >>> [round(volume, 3) for volume in curve.volumes.tolist()], round(curve.maximum_deviation, 2)
        ([0.785, 0.503], 0.36)
    """
    times = even_times() if times is None else torch.as_tensor(times, dtype=torch.double)
    measured = [volume_with_error(partial(morph, t=t), morph.bounds, resolution) for t in times.tolist()]
    volumes, errors = torch.tensor(measured, dtype=torch.double).unbind(1)
    wanted = torch.tensor([morph.wanted_volume(t) for t in times.tolist()], dtype=torch.double)
    return VolumeCurve(times, volumes, errors, wanted / wanted[0])
