"""Connected components of the moving surface."""

from __future__ import annotations

from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import COUNT

FEWEST = MorphMetric(
    name="fewest components",
    unit=COUNT,
    meaning="connected components of the surface, however small, at the time when they are fewest",
    section=Section.TOPOLOGY,
    ideal=None,
    compute=lambda measured: min(surface.components for surface in measured.surfaces),
)
MOST = MorphMetric(
    name="most components",
    unit=COUNT,
    meaning="connected components of the surface, however small, at the time when they are most",
    section=Section.TOPOLOGY,
    ideal=None,
    compute=lambda measured: max(surface.components for surface in measured.surfaces),
)
