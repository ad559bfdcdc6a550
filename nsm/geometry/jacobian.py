"""Jacobian determinants of the flow of a velocity field: how it changes volumes, and whether it folds space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.geometry.advection import DEFAULT_METHOD, Progress, RungeKutta, VelocityField, advect

#: Percentiles of the change of volume that are reported.
PERCENTILES = (1.0, 5.0, 50.0, 95.0, 99.0)


class TracedPoints(NamedTuple):
    """Points carried by a flow φ.

    Attributes:
        positions: Positions at k times, shape (k, n, d).
        determinants: det Dφ from the first time to each time, shape (k, n): the factor by which a small volume around
            each point has grown. It is 1 at the first time, and not positive where φ folds space.
    """

    positions: Float[Tensor, "k n d"]
    determinants: Float[Tensor, "k n"]


class VolumeChange(NamedTuple):
    """Distribution of det Dφ / w − 1 over points, where w is the factor by which volume should change.

    Attributes:
        folded: Share of the points where det Dφ ≤ 0.
        mean: Mean change.
        std: Standard deviation of the change.
        maximum: Greatest absolute change.
        percentiles: Changes at `PERCENTILES`.
    """

    folded: float
    mean: float
    std: float
    maximum: float
    percentiles: tuple[float, ...]

    @staticmethod
    def of(determinants: Float[Tensor, " n"], wanted: float = 1.0) -> VolumeChange:
        """Summarize determinants at one time.

        >>> VolumeChange.of(torch.tensor([1.0, 1.2, -0.1, 1.0])).folded
        0.25

        Args:
            determinants: det Dφ at points that represent equal volumes, shape (n,), of which there is at least one.
            wanted: w, 1 for a flow that should preserve volume.
        """
        change = determinants.double() / wanted - 1
        at = torch.tensor(PERCENTILES, dtype=torch.double, device=change.device) / 100
        return VolumeChange(
            float((determinants <= 0).double().mean()),
            float(change.mean()),
            float(change.std(correction=0)),
            float(change.abs().max()),
            tuple(change.quantile(at).tolist()),
        )


def trace_points(
    velocity: VelocityField,
    points: Float[Tensor, "n d"],
    times: Sequence[float],
    step: float,
    method: RungeKutta = DEFAULT_METHOD,
    progress: Progress | None = None,
) -> TracedPoints:
    """Advect points together with their Jacobians, from central differences of the flow.

    Every point has 2 d neighbors at distance ``step`` along the axes, which are advected as well:
    Dφ e_i = (φ(x + h e_i) − φ(x − h e_i)) / 2h, with an error of O(h²). The flow is integrated in double precision, so
    that the rounding of V alone, divided by h, limits the determinants.

    Args:
        velocity: The velocity V, which maps points, shape (n, d), and one time to velocities, shape (n, d).
        points: Points at the first time, shape (n, d).
        times: The k times.
        step: h, a length.
        method: The solver.
        progress: Called with the number of finished steps and of all steps.

    Example:
        >>> import torch
        >>> from nsm.geometry.jacobian import trace_points
        >>> traced = trace_points(lambda x, t: x, torch.rand(4, 2), [0.0, 1.0], step=1e-3)
        >>> traced.determinants[-1].round(decimals=3)  # exp(2)
        tensor([7.3890, 7.3890, 7.3890, 7.3890], dtype=torch.float64)
    """
    count, dim = points.shape
    x = points.double()
    shifts = step * torch.eye(dim).to(x)
    around = torch.cat([x, *(x + sign * shift for shift in shifts for sign in (1, -1))])
    moved = advect(velocity, around, times, method, progress=progress).view(len(times), 1 + 2 * dim, count, dim)
    after, before = moved[:, 1::2], moved[:, 2::2]
    jacobians = ((after - before) / (2 * step)).permute(0, 2, 3, 1)
    return TracedPoints(moved[:, 0], torch.linalg.det(jacobians))
