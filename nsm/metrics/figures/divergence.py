"""Divergence of V: the rate at which V changes volume. A wanted growth has one too."""

from __future__ import annotations

from nsm.metrics.averages import mean
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import RATE

SURFACE = MorphMetric(
    name="divergence surface",
    unit=RATE,
    meaning="mean of |div V| over surface and times; a growth has one too",
    section=Section.EQUATIONS,
    compute=lambda measured: mean(surface.divergence for surface in measured.surfaces),
)
SHELL = MorphMetric(
    name="divergence shell",
    unit=RATE,
    meaning="mean of |div V| in the shell around the surface, mean over times",
    section=Section.EQUATIONS,
    compute=lambda measured: mean(space.shell.divergence for space in measured.space),
)
BOX = MorphMetric(
    name="divergence box",
    unit=RATE,
    meaning="mean of |div V| in the whole box, mean over times",
    section=Section.EQUATIONS,
    compute=lambda measured: mean(space.box.divergence for space in measured.space),
)
