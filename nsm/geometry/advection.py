"""Points carried by a velocity field: dx/dt = V(x, t), forwards and backwards in time."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor
from torchdiffeq import odeint

from nsm.cli.errors import InputError
from nsm.geometry.grid import CHUNK

#: V at x (n, d) and one time: (n, d), in lengths per unit of time.
VelocityField = Callable[[Tensor, float], Tensor]
#: Moves points (n, d) to where they should be at one time, such as a level set.
Projection = Callable[[Tensor, float], Tensor]
#: Told after each stretch of time of each chunk of points: how many are done, of how many.
Progress = Callable[[int, int], object]


#: The least tolerance in roundings of 1, the size of the box: a step adds several of them.
_ROUNDINGS = 8


def _require_count(name: str, value: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise InputError(f"{name}={value} divides no time: give a whole number of at least 1")


class Method(ABC):
    """How dx/dt = V(x, t) is solved."""

    @abstractmethod
    def stops(self, start: float, end: float, projected: bool) -> list[float]:
        """Times from ``start`` to ``end``, both included, where the solver stops; there points may be projected."""

    @abstractmethod
    def advance(self, velocity: VelocityField, x: Float[Tensor, "n d"], start: float, end: float) -> Tensor:
        """Points (n, d) carried from one stop to the next."""


@dataclass(frozen=True)
class RungeKutta(Method):
    """The Runge-Kutta method of order 4 (the 3/8 rule): its error falls as steps⁻⁴ where V is smooth.

    Args:
        steps: in a unit of time, at least 1; each evaluates V four times.

    References:
        Kutta, Beitrag zur näherungsweisen Integration totaler Differentialgleichungen, 1901; torchdiffeq's ``rk4``.
    """

    steps: int = 32

    def __post_init__(self) -> None:
        _require_count("steps", self.steps)

    def stops(self, start: float, end: float, projected: bool) -> list[float]:
        """Evenly spaced times, no further apart than 1/steps."""
        return _even_stops(start, end, self.steps)

    def advance(self, velocity: VelocityField, x: Float[Tensor, "n d"], start: float, end: float) -> Tensor:
        """One step."""
        return _solve(velocity, x, start, end, method="rk4")


@dataclass(frozen=True)
class Adaptive(Method):
    """The method of Dormand and Prince of order 5, whose steps are as long as the tolerance lets them be.

    Args:
        tolerance: greatest error of a step, in units of length, at the point where it is greatest.
        stops_per_unit: how often in a unit of time points are projected, if they are.

    References:
        Dormand and Prince, A family of embedded Runge-Kutta formulae, 1980; torchdiffeq's ``dopri5``.
    """

    tolerance: float = 1e-5
    stops_per_unit: int = 32

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < math.inf:
            raise InputError(
                f"tolerance={self.tolerance} bounds no error of a step: give a positive length, such as 1e-5"
            )
        _require_count("stops_per_unit", self.stops_per_unit)

    def stops(self, start: float, end: float, projected: bool) -> list[float]:
        """The ends only, unless points are projected on the way."""
        return _even_stops(start, end, self.stops_per_unit) if projected else [start, end]

    def advance(self, velocity: VelocityField, x: Float[Tensor, "n d"], start: float, end: float) -> Tensor:
        """As many steps as it takes.

        Raises:
            InputError: if the tolerance is below what rounding lets be told, or V is not finite.
        """
        least = _ROUNDINGS * torch.finfo(x.dtype).eps
        if self.tolerance < least:
            raise InputError(
                f"tolerance={self.tolerance:g} is lost in the rounding of {x.dtype}: give {least:.1g} or more, or "
                "points in double precision"
            )
        settings = {"method": "dopri5", "rtol": 0.0, "atol": self.tolerance, "options": {"norm": _greatest}}
        try:
            return _solve(velocity, x, start, end, **settings)
        except AssertionError as error:  # torchdiffeq's: the steps have become too short, or points are not finite
            raise InputError(
                f"no step is short enough for tolerance={self.tolerance:g} at t = {start:g} to {end:g} ({error}): give "
                "a larger tolerance, or solve with RungeKutta"
            ) from error


#: What `carry` solves with unless told otherwise.
DEFAULT_METHOD = RungeKutta()


@torch.no_grad()
def carry(
    velocity: VelocityField,
    points: Float[Tensor, "n d"],
    times: Sequence[float] | Float[Tensor, " k"],
    method: Method = DEFAULT_METHOD,
    project: Projection | None = None,
    progress: Progress | None = None,
) -> Float[Tensor, "k n d"]:
    """Where points are at some times, when they start at the first of them and move with a velocity field.

    x(t_0) = x_0,  dx/dt = V(x, t).

    Times may run forwards, backwards, or to and fro. Points are carried a chunk at a time and without a graph, so that
    memory is that of the result.

    Args:
        velocity: V(x, t) (n, d) at points (n, d) and one time.
        points: x_0 (n, d), of any floating type; the result has its type and device.
        times: (k,), at least one.
        method: the solver.
        project: moves points (n, d) to where they belong at one time; applied at each stop of the method after the
            first, and so at each of ``times`` after the first.
        progress: called with the stretches done and their total.

    Returns:
        Positions (k, n, d), the first of which are the points themselves.

    Raises:
        InputError: if there is no time, or one is not finite.
    """
    moments = [float(t) for t in times]
    if not moments or not all(map(math.isfinite, moments)):
        raise InputError(f"points cannot be carried to the times {moments}: give finite numbers, the start first")
    stretches = [method.stops(start, end, project is not None) for start, end in pairwise(moments)]
    chunks = points.split(CHUNK) if len(points) else ()
    total, done = len(chunks) * sum(len(stops) - 1 for stops in stretches), 0
    carried = points.new_empty((len(moments), *points.shape))
    carried[0] = points
    for number, x in enumerate(chunks):
        place = slice(number * CHUNK, number * CHUNK + len(x))
        for index, stops in enumerate(stretches, 1):
            for start, end in pairwise(stops):
                x = method.advance(velocity, x, start, end)
                x = x if project is None else project(x, end).to(x)
                done += 1
                if progress is not None:
                    progress(done, total)
            carried[index, place] = x
    return carried


def _even_stops(start: float, end: float, per_unit: int) -> list[float]:
    if start == end:
        return [start]
    # a hair less, or rounding of the times costs a step
    count = max(1, math.ceil(abs(end - start) * per_unit - 1e-9))
    return [start + (end - start) * step / count for step in range(count)] + [end]


def _solve(velocity: VelocityField, x: Tensor, start: float, end: float, **settings: object) -> Tensor:
    if start == end:
        return x
    span = torch.tensor([start, end], dtype=torch.float64, device=x.device)
    return odeint(lambda t, y: velocity(y, float(t)).to(y), x, span, **settings)[-1]


def _greatest(x: Tensor) -> Tensor:
    return x.abs().max()
