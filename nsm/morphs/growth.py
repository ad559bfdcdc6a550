"""Morphs whose volume changes: a morph of constant volume, seen at a scale that changes with time.

Shapes of different volume are scaled to one volume, the morph between them is made there, and shown as
f̃(x, t) = α(t) f(x/α(t), t) (paper, section 7.4, equations 15 and 16), whose volume is α(t)^d times that of f. A
`Growth` says which α; its relative volumes are α^d, so 1 is the volume at which the morph was made.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pkgutil import resolve_name
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.shapes import FieldShape, Similarity
from nsm.types import Morph, SignedDistance

#: A time, or times (n,); a function of it gives the same kind.
Time = TypeVar("Time", float, Tensor)


class Growth(ABC):
    """How the volume of a morph goes from t = 0 to t = 1, relative to the constant volume at which it was made.

    Args:
        dim: dimension d of space.
    """

    def __init__(self, dim: int) -> None:
        self.dim = dim

    @abstractmethod
    def relative_volume(self, t: Time) -> Time:
        """α(t)^d > 0 at a time, or at times (n,)."""

    @abstractmethod
    def relative_rate(self, t: Time) -> Time:
        """The derivative of the relative volume, per unit of t."""

    @property
    @abstractmethod
    def extremes(self) -> tuple[float, float]:
        """Least and largest relative volume from t = 0 to 1."""

    def scale(self, t: Time) -> Time:
        """α(t), the factor by which lengths are multiplied."""
        return self.relative_volume(t) ** (1 / self.dim)

    def rate(self, t: Time) -> Time:
        """α'(t), per unit of t."""
        return self.relative_rate(t) * self.relative_volume(t) ** (1 / self.dim - 1) / self.dim


class _BetweenEnds(Growth):
    """A growth that two relative volumes settle.

    Args:
        dim: dimension d of space.
        source, target: relative volumes at t = 0 and 1; those of ``own`` if None.
        own: relative volumes of the two shapes before they were scaled to one volume.

    Raises:
        InputError: for a volume that is not positive.
    """

    def __init__(
        self,
        dim: int,
        source: float | None = None,
        target: float | None = None,
        own: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        super().__init__(dim)
        self.source = _positive("growth.source", own[0] if source is None else source)
        self.target = _positive("growth.target", own[1] if target is None else target)

    @property
    def extremes(self) -> tuple[float, float]:
        return min(self.source, self.target), max(self.source, self.target)


class VolumeLinear(_BetweenEnds):
    """The volume changes at a constant rate: α^d = (1 − t) v_0 + t v_1."""

    def relative_volume(self, t: Time) -> Time:
        return self.source + (self.target - self.source) * t

    def relative_rate(self, t: Time) -> Time:
        return self.target - self.source + 0 * t


class ScaleLinear(_BetweenEnds):
    """The size changes at a constant rate: α = (1 − t) v_0^(1/d) + t v_1^(1/d)."""

    def scale(self, t: Time) -> Time:
        return self.source ** (1 / self.dim) + self.rate(t) * t

    def rate(self, t: Time) -> Time:
        return self.target ** (1 / self.dim) - self.source ** (1 / self.dim) + 0 * t

    def relative_volume(self, t: Time) -> Time:
        return self.scale(t) ** self.dim

    def relative_rate(self, t: Time) -> Time:
        return self.dim * self.scale(t) ** (self.dim - 1) * self.rate(t)


class SmoothStep(_BetweenEnds):
    """The volume starts and stops changing gently: α^d = v_0 + (v_1 − v_0) (3t² − 2t³)."""

    def relative_volume(self, t: Time) -> Time:
        return self.source + (self.target - self.source) * t * t * (3 - 2 * t)

    def relative_rate(self, t: Time) -> Time:
        return (self.target - self.source) * 6 * t * (1 - t)


class Table(Growth):
    """The volume passes through given values: piecewise cubic, smooth, and monotone between neighbours (PCHIP).

    Args:
        dim: dimension d of space.
        times: increasing, from 0 to 1.
        volumes: relative volume at each time; the first and the last may be None for that of ``own``.
        own: relative volumes of the two shapes before they were scaled to one volume.

    Raises:
        InputError: for times that do not increase from 0 to 1, or volumes that are not as many positive numbers.

    References:
        Fritsch and Butland, A method for constructing local monotone piecewise cubic interpolants, SISSC 1984.
    """

    def __init__(
        self,
        dim: int,
        times: Sequence[float] = (0.0, 1.0),
        volumes: Sequence[float | None] = (None, None),
        own: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        super().__init__(dim)
        times, volumes = _listed("growth.times", times), _listed("growth.volumes", volumes)
        if len(times) != len(volumes):
            raise InputError(
                f"growth.times has {len(times)} entries and growth.volumes {len(volumes)}: give one volume a time"
            )
        numbers = [_number("growth.times", time) for time in times]
        if len(numbers) < 2 or (numbers[0], numbers[-1]) != (0, 1) or not bool((np.diff(numbers) > 0).all()):
            raise InputError(f"growth.times={times} do not increase from 0 to 1: give times such as [0,0.3,1]")
        filled = [own[0] if volumes[0] is None else volumes[0], *volumes[1:]]
        filled[-1] = own[1] if filled[-1] is None else filled[-1]
        values = [_positive("growth.volumes", value) for value in filled]
        curve = PchipInterpolator(numbers, values)
        self.extremes_of_table = min(values), max(values)
        self._knots = torch.tensor(numbers, dtype=torch.double)
        self._cubics = torch.from_numpy(curve.c.copy())
        self._slopes = torch.from_numpy(curve.derivative().c.copy())

    @property
    def extremes(self) -> tuple[float, float]:
        return self.extremes_of_table

    def relative_volume(self, t: Time) -> Time:
        return self._evaluate(self._cubics, t)

    def relative_rate(self, t: Time) -> Time:
        return self._evaluate(self._slopes, t)

    def _evaluate(self, coefficients: Tensor, t: Time) -> Time:
        """The piece that holds each time, by Horner's scheme; coefficients (order, pieces), highest power first."""
        if not isinstance(t, Tensor):
            return float(self._evaluate(coefficients, torch.tensor(t, dtype=torch.double)))
        knots, coefficients = self._knots.to(t), coefficients.to(t)
        piece = torch.searchsorted(knots[1:-1], t.detach(), right=True)
        since = t - knots[piece]
        value = torch.zeros_like(t)
        for row in coefficients:
            value = value * since + row[piece]
        return value


class Grown(Morph):
    """A morph with a changing volume, f̃(x, t) = α(t) f(x/α(t), t) (equation 16).

    f̃ is a distance where f is, ∇f̃(x, t) = ∇f(x/α, t), and its surface is carried by

        Ṽ(x, t) = α V(x/α, t) + (α'/α) x,    div Ṽ(x, t) = div V(x/α, t) + d α'/α,

    V along the scaled shape and a growth about the origin. Off the surface a distance cannot both grow and be carried:
    where V carries f, ∂f̃/∂t + ⟨∇f̃, Ṽ⟩ = (α'/α) f̃, which is 0 on the surface only.

    f is asked for in its own box alone, for beyond that a network may hold anything: outside the scaled box, `box`, f̃
    is its value at the nearest point of it plus the distance to that point, and V and div V are those at that point.

    Args:
        morph: f, at constant volume.
        growth: α.

    Attributes:
        dim: dimension d of space.
        bounds: corners (2, d) of a box that holds the box of ``morph`` at each of its scales.
        source, target: the end shapes of ``morph``, scaled by α(0) and α(1).
    """

    def __init__(self, morph: Morph, growth: Growth) -> None:
        self.morph, self.growth, self.dim, self.provenance = morph, growth, morph.dim, morph.provenance
        boxes = torch.stack([morph.bounds * relative ** (1 / morph.dim) for relative in growth.extremes])
        self.bounds = torch.stack([boxes[:, 0].amin(0), boxes[:, 1].amax(0)])
        self.source: SignedDistance = _scaled(morph.source, growth.scale(0.0), self.dim)
        self.target: SignedDistance = _scaled(morph.target, growth.scale(1.0), self.dim)

    def __call__(self, x: Float[Tensor, "n d"], t: float | Tensor) -> Float[Tensor, " n"]:
        """Signed distance (n,) at x (n, d) and time t, one number or (n,); negative inside."""
        near, beyond, scale = self._pulled_back(x, t)
        return scale[:, 0] * (self.morph(near, t) + beyond.norm(dim=1))

    def gradient(self, x: Float[Tensor, "n d"], t: float | Tensor) -> Float[Tensor, "n d"]:
        """Spatial gradient (n, d) of the signed distance."""
        near, beyond, _ = self._pulled_back(x, t)
        gradient = self.morph.gradient(near, t)
        return torch.where(beyond == 0, gradient, torch.nn.functional.normalize(beyond, dim=1))

    @property
    def has_velocity(self) -> bool:
        return self.morph.has_velocity

    def velocity(self, x: Float[Tensor, "n d"], t: float | Tensor) -> Float[Tensor, "n d"] | None:
        """Velocity (n, d), in units of length per unit of t; None for a method without a velocity field."""
        near, _, scale = self._pulled_back(x, t)
        velocity = self.morph.velocity(near, t)
        return None if velocity is None else scale * velocity + self._rate(x, t) / scale * x

    def divergence(self, x: Float[Tensor, "n d"], t: float | Tensor) -> Float[Tensor, " n"] | None:
        """Divergence (n,) of the velocity in space; None for a method without a velocity field."""
        near, _, scale = self._pulled_back(x, t)
        divergence = self.morph.divergence(near, t)
        return None if divergence is None else divergence + self.dim * (self._rate(x, t) / scale)[:, 0]

    def domain(self, t: float) -> Float[Tensor, "2 d"]:
        """Corners of the domain of the morph, scaled by α(t)."""
        return self.morph.domain(t) * self.growth.scale(t)

    def wanted_volume(self, t: float, initial: float = 1.0) -> float:
        """V(0) (α(t)/α(0))^d, with V(0) the initial volume."""
        relative = self.growth.relative_volume(t) / self.growth.relative_volume(0.0)
        return self.morph.wanted_volume(t, initial) * relative

    def _pulled_back(self, x: Tensor, t: float | Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """x/α moved into the box of the morph (n, d), by how much (n, d), and α as a column of one row or n."""
        x = x.to(self.morph.bounds)
        scale = self.growth.scale(torch.as_tensor(t).to(x)).reshape(-1, 1)
        point = x / scale
        near = torch.minimum(torch.maximum(point, self.morph.bounds[0]), self.morph.bounds[1])
        return near, point - near, scale

    def _rate(self, x: Tensor, t: float | Tensor) -> Tensor:
        """α' as a column."""
        return self.growth.rate(torch.as_tensor(t).to(x)).reshape(-1, 1)


def build_growth(config: Mapping[str, Any] | None, dim: int, own: tuple[float, float] = (1.0, 1.0)) -> Growth | None:
    """The growth that a configuration describes, None where it has no ``_target_`` (``growth=none``).

    Args:
        config: ``_target_``, a subclass of `Growth`, and its arguments.
        dim: dimension d of space.
        own: relative volumes of the two shapes before they were scaled to one volume.

    Raises:
        InputError: if it names no growth, or arguments that it cannot take.
    """
    settings = dict(config or {})
    target = settings.pop("_target_", None)
    if target is None:
        return None
    try:
        made = resolve_name(str(target))(dim=dim, own=own, **settings)
    except (ImportError, AttributeError, TypeError) as error:
        raise InputError(
            f"growth._target_={target} cannot be made of {settings} ({error}): give one of conf/growth, such as "
            "growth=volume_linear"
        ) from error
    if not isinstance(made, Growth):
        raise InputError(
            f"growth._target_={target} is no subclass of nsm.morphs.growth.Growth: give growth=volume_linear"
        )
    return made


def _scaled(shape: SignedDistance, scale: float, dim: int) -> SignedDistance:
    """s g(x/s), as a shape where g is one."""
    if isinstance(shape, FieldShape):
        return shape.transformed(Similarity.scaling(scale, dim))
    return lambda x: scale * shape(x / scale)


def _positive(name: str, value: Any) -> float:
    number = _number(name, value)
    if not 0 < number < math.inf:
        raise InputError(f"{name} has the volume {value}, but a volume is positive: give a number such as 2")
    return number


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{name} has the entry {value!r}, which is no number: give one such as 0.5")
    return float(value)


def _listed(name: str, values: Any) -> list[Any]:
    if isinstance(values, str) or not isinstance(values, Sequence):
        raise InputError(f"{name}={values} is no list: give one such as {name}=[0,0.3,1]")
    return list(values)
