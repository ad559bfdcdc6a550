"""Residual of the eikonal equation ‖∇f‖ = 1."""

from __future__ import annotations

from nsm.metrics import averages
from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import RELATIVE


@MorphMetric.define("eikonal shell", RELATIVE, Section.EQUATIONS)
def shell(measured: Measurements) -> float:
    """Mean of |‖∇f‖ − 1| in the shell around the surface, mean over times."""
    return averages.mean(space.shell.eikonal for space in measured.space)


@MorphMetric.define("eikonal box", RELATIVE, Section.EQUATIONS)
def box(measured: Measurements) -> float:
    """Mean of |‖∇f‖ − 1| in the whole box, mean over times."""
    return averages.mean(space.box.eikonal for space in measured.space)
