"""Residual of the level set equation ∂f/∂t + ⟨∇f, V⟩ = 0, as a speed along the normal."""

from __future__ import annotations

from nsm.metrics.averages import mean
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import SPEED

SURFACE = MorphMetric(
    name="level set surface",
    unit=SPEED,
    meaning="mean of |df/dt + <grad f, V>| / |grad f| over surface and times",
    section=Section.EQUATIONS,
    heading="level set error",
    compute=lambda measured: mean(surface.level_set for surface in measured.surfaces),
)
SHELL = MorphMetric(
    name="level set shell",
    unit=SPEED,
    meaning="mean of |df/dt + <grad f, V>| over mean of |grad f| in the shell around the surface, mean over times",
    section=Section.EQUATIONS,
    compute=lambda measured: mean(space.shell.level_set for space in measured.space),
)
BOX = MorphMetric(
    name="level set box",
    unit=SPEED,
    meaning="mean of |df/dt + <grad f, V>| over mean of |grad f| in the whole box, mean over times",
    section=Section.EQUATIONS,
    compute=lambda measured: mean(space.box.level_set for space in measured.space),
)
