"""Norm of ∇f on the moving surface: 1 everywhere for a signed distance."""

from __future__ import annotations

from nsm.metrics.averages import greatest, least, mean
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import RATIO, RELATIVE

MEAN = MorphMetric(
    name="gradient norm mean",
    unit=RATIO,
    meaning="mean of |grad f| over surface and times: 1 for a distance",
    section=Section.EQUATIONS,
    ideal=1.0,
    heading="‖∇f‖",
    compute=lambda measured: mean(surface.gradient_norm for surface in measured.surfaces),
)
LEAST = MorphMetric(
    name="gradient norm least",
    unit=RATIO,
    meaning="mean of |grad f| over the surface, at the time when it is least",
    section=Section.EQUATIONS,
    ideal=1.0,
    compute=lambda measured: least(surface.gradient_norm for surface in measured.surfaces),
)
GREATEST = MorphMetric(
    name="gradient norm greatest",
    unit=RATIO,
    meaning="mean of |grad f| over the surface, at the time when it is greatest",
    section=Section.EQUATIONS,
    ideal=1.0,
    compute=lambda measured: greatest(surface.gradient_norm for surface in measured.surfaces),
)
STD = MorphMetric(
    name="gradient norm std",
    unit=RELATIVE,
    meaning="standard deviation of |grad f| over the surface, mean over times",
    section=Section.EQUATIONS,
    compute=lambda measured: mean(surface.gradient_norm_std for surface in measured.surfaces),
)
