"""Advection of points along a velocity field, dx/dt = V(x, t) (paper, eq. 7), forward and backward in time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor
from torchdiffeq import odeint

from nsm.cli.errors import InputError
from nsm.cli.settings import whole_number
from nsm.geometry.grid import CHUNK

#: Maps points, shape (n, d), and one time to velocities, shape (n, d), in length per unit of time.
VelocityField = Callable[[Tensor, float], Tensor]
#: Moves points, shape (n, d), to the set where they belong at one time, such as a level set.
Projection = Callable[[Tensor, float], Tensor]
#: Called with the number of finished parts of a computation and their total.
Progress = Callable[[int, int], object]


@dataclass(frozen=True)
class RungeKutta:
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

    def stops(self, start: float, end: float) -> list[float]:
        """List evenly spaced times from ``start`` to ``end``, inclusive and at most 1/steps apart."""
        if start == end:
            return [start]
        # the margin keeps rounding errors of the times from adding a step
        count = max(1, math.ceil(abs(end - start) * self.steps - 1e-9))
        return [start + (end - start) * step / count for step in range(count)] + [end]

    def advance(
        self, velocity: VelocityField, x: Float[Tensor, "n d"], start: float, end: float
    ) -> Float[Tensor, "n d"]:
        """Advect points by one step.

        Args:
            velocity: The velocity V(x, t).
            x: Points at time ``start``, shape (n, d).
            start, end: Times of successive stops.

        Returns:
            Points at time ``end``, shape (n, d).
        """
        span = torch.tensor([start, end], dtype=torch.float64, device=x.device)
        return odeint(lambda t, y: velocity(y, float(t)).to(y), x, span, method="rk4")[-1]


#: Solver that `advect` uses by default.
DEFAULT_METHOD = RungeKutta()


@torch.no_grad()
def advect(
    velocity: VelocityField,
    points: Float[Tensor, "n d"],
    times: Sequence[float] | Float[Tensor, " k"],
    method: RungeKutta = DEFAULT_METHOD,
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
        >>> advect(rotation, torch.tensor([[1.0, 1.0]]), times=[0.0, 1.0])[-1].round(decimals=3)
        tensor([[-1.,  1.]])
    """
    instants = [float(t) for t in times]
    if not instants or not all(map(math.isfinite, instants)):
        raise InputError(f"`times` must be finite numbers, at least one, got {instants}. Try `times=[0.0, 1.0]`.")
    intervals = [method.stops(start, end) for start, end in pairwise(instants)]
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
