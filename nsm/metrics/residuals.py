"""Residuals of the level set equation ∂f/∂t + ⟨∇f, V⟩ = 0 and of the eikonal equation ‖∇f‖ = 1, and div V."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.types import Morph

#: Points over which the surface and each region are averaged by default, and greatest number of draws of as many points
#: to find those in the shell.
SAMPLES, TRIES = 10_000, 16
#: |f| on the rim of the shell around the surface, in units of length.
SHELL_WIDTH = 0.05
#: Step in time of the difference that gives ∂f/∂t.
TIME_STEP = 1e-3


class RegionResiduals(NamedTuple):
    """Means over a region of space at one time; nan where the region has no points, or the morph no velocity.

    Attributes:
        time: The time.
        points: Number of points that were averaged.
        eikonal: Mean of |‖∇f‖ − 1|.
        level_set: Mean of |∂f/∂t + ⟨∇f, V⟩| over the mean of ‖∇f‖, a length per unit of time. It does not depend on the
            scale of f, and points where ∇f vanishes, which every shape has, do not dominate it.
        divergence: Mean of |div V|, per unit of time.
    """

    time: float
    points: int
    eikonal: float
    level_set: float
    divergence: float


class SpaceResiduals(NamedTuple):
    """Residuals at one time.

    Attributes:
        shell: In the shell {|f| < width} around the surface.
        box: In the whole box.
    """

    shell: RegionResiduals
    box: RegionResiduals


@torch.no_grad()
def space_residuals(morph: Morph, time: float, width: float = SHELL_WIDTH, samples: int = SAMPLES) -> SpaceResiduals:
    """Measure the residuals at points drawn evenly in ``morph.bounds``, the same ones in each call.

    Args:
        morph: Morph to measure.
        time: The time.
        width: |f| on the rim of the shell, in units of length.
        samples: Number of points in the box, and at most in the shell.
    """
    low, high = morph.bounds
    generator = torch.Generator(low.device).manual_seed(0)

    def draw() -> Tensor:
        share = torch.rand(samples, morph.dim, generator=generator, dtype=low.dtype, device=low.device)
        return low + share * (high - low)

    box = drawn = draw()
    shell = drawn[morph(drawn, time).abs() < width]
    for _ in range(TRIES - 1):
        if len(shell) >= samples:
            break
        drawn = draw()
        shell = torch.cat([shell, drawn[morph(drawn, time).abs() < width]])
    return SpaceResiduals(*(_region(morph, region, time) for region in (shell[:samples], box)))


def rate(morph: Morph, x: Float[Tensor, "n d"], time: float) -> Float[Tensor, " n"]:
    """Partial derivative ∂f/∂t by differences of second order, one-sided near 0 and 1, where a morph may end.

    Args:
        morph: Morph that gives f.
        x: Points, shape (n, d).
        time: The time.

    Returns:
        ∂f/∂t, shape (n,).
    """
    with torch.no_grad():
        # weight of f by the number of steps from the time
        if time < TIME_STEP:
            stencil = {0: -1.5, 1: 2.0, 2: -0.5}
        elif time > 1 - TIME_STEP:
            stencil = {0: 1.5, -1: -2.0, -2: 0.5}
        else:
            stencil = {1: 0.5, -1: -0.5}
        values = [weight * morph(x, time + step * TIME_STEP) for step, weight in stencil.items()]
        return torch.stack(values).sum(0) / TIME_STEP


def level_set_residual(morph: Morph, x: Float[Tensor, "n d"], time: float) -> Float[Tensor, " n"] | None:
    """Residual of the level set equation, ∂f/∂t + ⟨∇f, V⟩, shape (n,); None for a morph without velocity."""
    velocity = morph.velocity(x, time)
    if velocity is None:
        return None
    return (rate(morph, x, time) + (morph.gradient(x, time) * velocity).sum(1)).detach()


def eikonal_residual(morph: Morph, x: Float[Tensor, "n d"], time: float) -> Float[Tensor, " n"]:
    """Residual of the eikonal equation, ‖∇f‖ − 1, shape (n,)."""
    return morph.gradient(x, time).detach().norm(dim=1) - 1


def divergence(morph: Morph, x: Float[Tensor, "n d"], time: float) -> Float[Tensor, " n"] | None:
    """Divergence of V per unit of time, detached, shape (n,); None for a morph without velocity."""
    value = morph.divergence(x, time)
    return None if value is None else value.detach()


def mean_magnitude(values: Float[Tensor, " n"] | None) -> float:
    """Mean of |values|; nan for None."""
    return math.nan if values is None else float(values.abs().mean())


def _region(morph: Morph, points: Tensor, time: float) -> RegionResiduals:
    if not len(points):
        return RegionResiduals(time, 0, math.nan, math.nan, math.nan)
    eikonal = eikonal_residual(morph, points, time)
    level_set = mean_magnitude(level_set_residual(morph, points, time)) / float((eikonal + 1).mean())
    div = mean_magnitude(divergence(morph, points, time))
    return RegionResiduals(time, len(points), mean_magnitude(eikonal), level_set, div)
