"""Norm of ∇f on the moving surface: 1 everywhere for a signed distance."""

from __future__ import annotations

from nsm.metrics import averages
from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import RATIO, RELATIVE


@MorphMetric.define("gradient norm mean", RATIO, Section.EQUATIONS, ideal=1.0, heading="‖∇f‖")
def mean(measured: Measurements) -> float:
    """Mean of ‖∇f‖ over surface and times: 1 for a distance."""
    return averages.mean(surface.gradient_norm for surface in measured.surfaces)


@MorphMetric.define("gradient norm least", RATIO, Section.EQUATIONS, ideal=1.0)
def least(measured: Measurements) -> float:
    """Mean of ‖∇f‖ over the surface, at the time when it is least."""
    return averages.least(surface.gradient_norm for surface in measured.surfaces)


@MorphMetric.define("gradient norm greatest", RATIO, Section.EQUATIONS, ideal=1.0)
def greatest(measured: Measurements) -> float:
    """Mean of ‖∇f‖ over the surface, at the time when it is greatest."""
    return averages.greatest(surface.gradient_norm for surface in measured.surfaces)


@MorphMetric.define("gradient norm std", RELATIVE, Section.EQUATIONS)
def std(measured: Measurements) -> float:
    """Standard deviation of ‖∇f‖ over the surface, mean over times."""
    return averages.mean(surface.gradient_norm_std for surface in measured.surfaces)
