"""Divergence of V: the rate at which V changes volume. A wanted growth has one too."""

from __future__ import annotations

from nsm.metrics import averages
from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import RATE


@MorphMetric.define("divergence surface", RATE, Section.EQUATIONS)
def surface(measured: Measurements) -> float:
    """Mean of |div V| over surface and times; a growth has one too."""
    return averages.mean(surface.divergence for surface in measured.surfaces)


@MorphMetric.define("divergence shell", RATE, Section.EQUATIONS)
def shell(measured: Measurements) -> float:
    """Mean of |div V| in the shell around the surface, mean over times."""
    return averages.mean(space.shell.divergence for space in measured.space)


@MorphMetric.define("divergence box", RATE, Section.EQUATIONS)
def box(measured: Measurements) -> float:
    """Mean of |div V| in the whole box, mean over times."""
    return averages.mean(space.box.divergence for space in measured.space)
