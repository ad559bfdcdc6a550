"""Connected components of the moving surface that are large enough to be seen."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import COUNT


@MorphMetric.define("fewest pieces", COUNT, Section.TOPOLOGY, ideal=None)
def fewest(measured: Measurements) -> float:
    """Components that enclose more than 1e-5 of the volume of the largest, at the time when they are fewest."""
    return min(surface.pieces for surface in measured.surfaces)


@MorphMetric.define("most pieces", COUNT, Section.TOPOLOGY, ideal=None, heading="components")
def most(measured: Measurements) -> float:
    """Components that enclose more than 1e-5 of the volume of the largest, at the time when they are most."""
    return max(surface.pieces for surface in measured.surfaces)
