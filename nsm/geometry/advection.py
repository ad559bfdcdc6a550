"""Advection of points along a velocity field, dx/dt = V(x, t) (paper, eq. 7), forward and backward in time."""

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
from nsm.cli.settings import positive, whole_number
from nsm.geometry.grid import CHUNK

#: Maps points, shape (n, d), and one time to velocities, shape (n, d), in length per unit of time.
VelocityField = Callable[[Tensor, float], Tensor]
#: Moves points, shape (n, d), to the set where they belong at one time, such as a level set.
Projection = Callable[[Tensor, float], Tensor]
#: Called with the number of finished parts of a computation and their total.
Progress = Callable[[int, int], object]

#: Smallest tolerance in units of the rounding error of 1, the scale of the box: each step adds several such errors.
_MIN_ROUNDING_ERRORS = 8


class AdvectionMethod(ABC):
    """A solver of dx/dt = V(x, t)."""

    @abstractmethod
    def stops(self, start: float, end: float, projected: bool) -> list[float]:
        """List the times from ``start`` to ``end``, inclusive, at which the solver stops and points may be projected.

        Args:
            start, end: Times between which points are advected.
            projected: Whether points are projected at the stops.
        """

    @abstractmethod
    def advance(self, velocity: VelocityField, x: Float[Tensor, "n d"], start: float, end: float) -> Tensor:
        """Advect points from one stop to the next.

        Args:
            velocity: The velocity V(x, t).
            x: Points at time ``start``, shape (n, d).
            start, end: Times of the two stops.

        Returns:
            Points at time ``end``, shape (n, d).
        """


@dataclass(frozen=True)
class RungeKutta(AdvectionMethod):
    """The Runge-Kutta method of order 4 with fixed steps (3/8 rule), whose error is O(steps⁻⁴) for a smooth V.

    Args:
        steps: Number of steps per unit of time, at least 1. Each step evaluates V four times.

    Raises:
        InputError: If ``steps`` is not a positive integer.

    References:
        Kutta, Beitrag zur näherungsweisen Integration totaler Differentialgleichungen, 1901.
        Implementation: ``rk4`` of torchdiffeq, https://github.com/rtqichen/torchdiffeq
    """

    steps: int = 32

    def __post_init__(self) -> None:
        whole_number("steps", self.steps, example=32)

    def stops(self, start: float, end: float, projected: bool) -> list[float]:
        """List evenly spaced times at most 1/steps apart."""
        return _even_stops(start, end, self.steps)

    def advance(self, velocity: VelocityField, x: Float[Tensor, "n d"], start: float, end: float) -> Tensor:
        """Advect points by one step."""
        return _solve(velocity, x, start, end, method="rk4")


@dataclass(frozen=True)
class Adaptive(AdvectionMethod):
    """The Runge-Kutta method of order 5 of Dormand and Prince, which chooses its steps according to a tolerance.

    Args:
        tolerance: Maximum error of one step at any point, in length.
        stops_per_unit: Number of stops per unit of time if points are projected.

    Raises:
        InputError: If ``tolerance`` is not positive and finite, or ``stops_per_unit`` is not a positive integer.

    References:
        Dormand and Prince, A family of embedded Runge-Kutta formulae, Journal of Computational and Applied Mathematics
        1980. https://doi.org/10.1016/0771-050X(80)90013-3
        Implementation: ``dopri5`` of torchdiffeq, https://github.com/rtqichen/torchdiffeq
    """

    tolerance: float = 1e-5
    stops_per_unit: int = 32

    def __post_init__(self) -> None:
        positive("tolerance", self.tolerance, example=1e-5)
        whole_number("stops_per_unit", self.stops_per_unit, example=32)

    def stops(self, start: float, end: float, projected: bool) -> list[float]:
        """List the two ends, or evenly spaced times if points are projected."""
        return _even_stops(start, end, self.stops_per_unit) if projected else [start, end]

    def advance(self, velocity: VelocityField, x: Float[Tensor, "n d"], start: float, end: float) -> Tensor:
        """Advect points by as many steps as the tolerance requires.

        Raises:
            InputError: If the tolerance is below the rounding error of the points, or V is not finite.
        """
        least = _MIN_ROUNDING_ERRORS * torch.finfo(x.dtype).eps
        if self.tolerance < least:
            raise InputError(
                f"`tolerance` must be at least {least:.1g} for points of {x.dtype}, got {self.tolerance:g}. Try "
                f"`tolerance={least:.1g}`, or points of double precision."
            )
        settings = {"method": "dopri5", "rtol": 0.0, "atol": self.tolerance, "options": {"norm": _maximum_norm}}
        try:
            return _solve(velocity, x, start, end, **settings)
        except AssertionError as error:  # torchdiffeq asserts that steps are not too short and points finite
            raise InputError(
                f"`tolerance` must be reachable with steps that change the time, got {self.tolerance:g} between "
                f"t = {start:g} and {end:g} ({error}). Try a larger `tolerance`, or `RungeKutta()`."
            ) from error


#: Solver that `advect` uses by default.
DEFAULT_METHOD = RungeKutta()


@torch.no_grad()
def advect(
    velocity: VelocityField,
    points: Float[Tensor, "n d"],
    times: Sequence[float] | Float[Tensor, " k"],
    method: AdvectionMethod = DEFAULT_METHOD,
    project: Projection | None = None,
    progress: Progress | None = None,
) -> Float[Tensor, "k n d"]:
    """Advect points along a velocity field: solve dx/dt = V(x, t) with x(t_0) = x_0 (paper, eq. 7).

    Times may increase, decrease, or alternate. Points are advected in chunks and without a graph, so that the result
    dominates memory.

    Args:
        velocity: The velocity V, which maps points, shape (n, d), and one time to velocities, shape (n, d).
        points: Points x_0, shape (n, d). The result has their dtype and device.
        times: Times t_0, …, t_{k−1}, of which there is at least one, shape (k,).
        method: The solver.
        project: Projection applied at all stops of the solver after the first, which include ``times``.
        progress: Called with the number of finished steps between stops and their total, over all chunks.

    Returns:
        Positions at all times, shape (k, n, d); the first are the points themselves.

    Raises:
        InputError: If there are no times, or one is not finite.

    Example:
        >>> import torch
        >>> from nsm.geometry.advection import advect
        >>> def rotation(x, t):
        ...     return torch.pi / 2 * torch.stack([-x[:, 1], x[:, 0]], dim=1)
        >>> advect(rotation, torch.tensor([[1.0, 0.0]]), times=[0.0, 1.0])[-1].round(decimals=3)
        tensor([[0., 1.]])
    """
    instants = [float(t) for t in times]
    if not instants or not all(map(math.isfinite, instants)):
        raise InputError(f"`times` must be finite numbers, at least one, got {instants}. Try `times=[0.0, 1.0]`.")
    intervals = [method.stops(start, end, project is not None) for start, end in pairwise(instants)]
    chunks = points.split(CHUNK) if len(points) else ()
    total, done = len(chunks) * sum(len(stops) - 1 for stops in intervals), 0
    advected = points.new_empty((len(instants), *points.shape))
    advected[0] = points
    for number, x in enumerate(chunks):
        rows = slice(number * CHUNK, number * CHUNK + len(x))
        for index, stops in enumerate(intervals, 1):
            for start, end in pairwise(stops):
                x = method.advance(velocity, x, start, end)
                x = x if project is None else project(x, end).to(x)
                done += 1
                if progress is not None:
                    progress(done, total)
            advected[index, rows] = x
    return advected


def _even_stops(start: float, end: float, per_unit: int) -> list[float]:
    if start == end:
        return [start]
    # the margin keeps rounding errors of the times from adding a step
    count = max(1, math.ceil(abs(end - start) * per_unit - 1e-9))
    return [start + (end - start) * step / count for step in range(count)] + [end]


def _solve(velocity: VelocityField, x: Tensor, start: float, end: float, **settings: object) -> Tensor:
    if start == end:
        return x
    span = torch.tensor([start, end], dtype=torch.float64, device=x.device)
    return odeint(lambda t, y: velocity(y, float(t)).to(y), x, span, **settings)[-1]


def _maximum_norm(x: Tensor) -> Tensor:
    return x.abs().max()
