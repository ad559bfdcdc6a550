"""Residual of the level set equation ∂f/∂t + ⟨∇f, V⟩ = 0, as a speed along the normal."""

from __future__ import annotations

from nsm.metrics import averages
from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import SPEED


@MorphMetric.define("level set surface", SPEED, Section.EQUATIONS, heading="level set error")
def surface(measured: Measurements) -> float:
    """Mean of |∂f/∂t + ⟨∇f, V⟩| / ‖∇f‖ over surface and times."""
    return averages.mean(surface.level_set for surface in measured.surfaces)


@MorphMetric.define("level set shell", SPEED, Section.EQUATIONS)
def shell(measured: Measurements) -> float:
    """Mean of |∂f/∂t + ⟨∇f, V⟩| over mean of ‖∇f‖ in the shell around the surface, mean over times."""
    return averages.mean(space.shell.level_set for space in measured.space)


@MorphMetric.define("level set box", SPEED, Section.EQUATIONS)
def box(measured: Measurements) -> float:
    """Mean of |∂f/∂t + ⟨∇f, V⟩| over mean of ‖∇f‖ in the whole box, mean over times."""
    return averages.mean(space.box.level_set for space in measured.space)
