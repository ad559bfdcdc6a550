"""Residuals of the level set equation ∂f/∂t + ⟨∇f, V⟩ = 0 and of the eikonal equation ‖∇f‖ = 1, and div V."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.types import Morph

#: Points drawn evenly in the box to find those in the shell, and points over which each region is averaged.
SAMPLES, REGION_SAMPLES = 1 << 17, 1 << 13
#: |f| on the rim of the shell around the surface, in units of length.
SHELL_WIDTH = 0.05
#: Step in time of the difference that gives ∂f/∂t.
TIME_STEP = 1e-3


class RegionResiduals(NamedTuple):
    """Means over a part of space at one time; not a number where it has no points, or there is no velocity."""

    time: float
    #: How many points were looked at.
    points: int
    #: Mean of |‖∇f‖ − 1|, without unit.
    eikonal: float
    #: Mean of |∂f/∂t + ⟨∇f, V⟩| over the mean of ‖∇f‖, a length per unit of time; scaling f does not change it, and
    #: the places where ∇f vanishes (there are some in every shape) do not rule it.
    level_set: float
    #: Mean of |div V|, per unit of time.
    divergence: float


class SpaceResiduals(NamedTuple):
    """Residuals at one time in the shell {|f| < width} and in the whole box."""

    shell: RegionResiduals
    box: RegionResiduals


@torch.no_grad()
def space_residuals(morph: Morph, time: float, width: float = SHELL_WIDTH) -> SpaceResiduals:
    """Measure the residuals at points drawn evenly in ``morph.bounds``, always the same ones.

    Args:
        morph: the morph.
        time: when to look.
        width: |f| on the rim of the shell.
    """
    low, high = morph.bounds
    generator = torch.Generator(low.device).manual_seed(0)
    share = torch.rand(SAMPLES, morph.dim, generator=generator, dtype=low.dtype, device=low.device)
    points = low + share * (high - low)
    near = points[morph(points, time).abs() < width]
    return SpaceResiduals(*(_region(morph, region[:REGION_SAMPLES], time) for region in (near, points)))


def rate(morph: Morph, x: Float[Tensor, "n d"], time: float) -> Float[Tensor, " n"]:
    """∂f/∂t (n,) by differences of second order: central, and one-sided at 0 and 1, where a morph may end."""
    with torch.no_grad():
        # steps and their weights
        if time < TIME_STEP:
            stencil = {0: -1.5, 1: 2.0, 2: -0.5}
        elif time > 1 - TIME_STEP:
            stencil = {0: 1.5, -1: -2.0, -2: 0.5}
        else:
            stencil = {1: 0.5, -1: -0.5}
        values = [weight * morph(x, time + step * TIME_STEP) for step, weight in stencil.items()]
        return torch.stack(values).sum(0) / TIME_STEP


def level_set_residual(morph: Morph, x: Float[Tensor, "n d"], time: float) -> Float[Tensor, " n"] | None:
    """∂f/∂t + ⟨∇f, V⟩ (n,), a distance per unit of time where f is one; None for a method without velocity."""
    velocity = morph.velocity(x, time)
    if velocity is None:
        return None
    return (rate(morph, x, time) + (morph.gradient(x, time) * velocity).sum(1)).detach()


def eikonal_residual(morph: Morph, x: Float[Tensor, "n d"], time: float) -> Float[Tensor, " n"]:
    """‖∇f‖ − 1 (n,): 0 for a distance."""
    return morph.gradient(x, time).detach().norm(dim=1) - 1


def divergence(morph: Morph, x: Float[Tensor, "n d"], time: float) -> Float[Tensor, " n"] | None:
    """div V (n,) per unit of time, detached; None without V."""
    value = morph.divergence(x, time)
    return None if value is None else value.detach()


def mean_size(values: Float[Tensor, " n"] | None) -> float:
    """Mean of |values|; not a number where there are none."""
    return math.nan if values is None else float(values.abs().mean())


def _region(morph: Morph, points: Tensor, time: float) -> RegionResiduals:
    if not len(points):
        return RegionResiduals(time, 0, math.nan, math.nan, math.nan)
    eikonal = eikonal_residual(morph, points, time)
    level_set = mean_size(level_set_residual(morph, points, time)) / float((eikonal + 1).mean())
    return RegionResiduals(time, len(points), mean_size(eikonal), level_set, mean_size(divergence(morph, points, time)))
