"""Is f still a distance on the moving surface, and does the velocity carry that surface?"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import torch

from nsm.geometry.distance import sample_mesh
from nsm.geometry.meshing import extract_surface
from nsm.types import Morph

#: Points drawn on the surface.
SAMPLES = 10_000
#: Step in time of the difference that gives ∂f/∂t.
_TIME_STEP = 1e-3
#: When the residuals are looked at unless told otherwise.
QUARTERS = (0.0, 0.25, 0.5, 0.75, 1.0)


class SurfaceResiduals(NamedTuple):
    """What holds on the surface at one time; not a number where there is no surface, or no velocity."""

    time: float
    #: Mean and standard deviation of ‖∇f‖: 1 and 0 for a distance.
    gradient_norm: float
    gradient_norm_std: float
    #: Mean of |∂f/∂t + ⟨∇f, V⟩| / ‖∇f‖: the speed at which V leaves the surface behind, along the normal.
    level_set: float


def surface_residuals(morph: Morph, time: float, resolution: int = 96) -> SurfaceResiduals:
    """Measure ‖∇f‖ and the level set residual on the surface at ``time``, extracted on ``resolution``^d cells."""
    mesh = extract_surface(partial(morph, t=time), morph.bounds, resolution)
    if not len(mesh.simplices):
        return SurfaceResiduals(time, math.nan, math.nan, math.nan)
    generator = torch.Generator(morph.bounds.device).manual_seed(0)
    points = sample_mesh(mesh, SAMPLES, generator).points
    gradient = morph.gradient(points, time).detach()
    norm = gradient.norm(dim=1)
    velocity = morph.velocity(points, time)
    level_set = math.nan
    if velocity is not None:
        # a morph need not go on before 0 or after 1
        before, after = max(0.0, time - _TIME_STEP), min(1.0, time + _TIME_STEP)
        with torch.no_grad():
            rate = (morph(points, after) - morph(points, before)) / (after - before)
        transported = (gradient * velocity.detach()).sum(1)
        level_set = float(((rate + transported).abs() / norm).mean())
    return SurfaceResiduals(time, float(norm.mean()), float(norm.std()), level_set)
