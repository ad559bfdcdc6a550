"""Residual of the eikonal equation ‖∇f‖ = 1."""

from __future__ import annotations

from nsm.metrics.averages import mean
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import RELATIVE

SHELL = MorphMetric(
    name="eikonal shell",
    unit=RELATIVE,
    meaning="mean of ||grad f| - 1| in the shell around the surface, mean over times",
    section=Section.EQUATIONS,
    compute=lambda measured: mean(space.shell.eikonal for space in measured.space),
)
BOX = MorphMetric(
    name="eikonal box",
    unit=RELATIVE,
    meaning="mean of ||grad f| - 1| in the whole box, mean over times",
    section=Section.EQUATIONS,
    compute=lambda measured: mean(space.box.eikonal for space in measured.space),
)
