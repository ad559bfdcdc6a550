"""Connected components of the moving surface."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import COUNT


@MorphMetric.define("fewest components", COUNT, Section.TOPOLOGY, ideal=None)
def fewest(measured: Measurements) -> float:
    """Connected components of the surface, however small, at the time when they are fewest."""
    return min(surface.components for surface in measured.surfaces)


@MorphMetric.define("most components", COUNT, Section.TOPOLOGY, ideal=None)
def most(measured: Measurements) -> float:
    """Connected components of the surface, however small, at the time when they are most."""
    return max(surface.components for surface in measured.surfaces)
