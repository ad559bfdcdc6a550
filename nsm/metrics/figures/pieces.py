"""Connected components of the moving surface that are large enough to be seen."""

from __future__ import annotations

from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import COUNT

FEWEST = MorphMetric(
    name="fewest pieces",
    unit=COUNT,
    meaning="components that enclose more than 1e-5 of the volume of the largest, at the time when they are fewest",
    section=Section.TOPOLOGY,
    ideal=None,
    compute=lambda measured: min(surface.pieces for surface in measured.surfaces),
)
MOST = MorphMetric(
    name="most pieces",
    unit=COUNT,
    meaning="components that enclose more than 1e-5 of the volume of the largest, at the time when they are most",
    section=Section.TOPOLOGY,
    ideal=None,
    heading="components",
    compute=lambda measured: max(surface.pieces for surface in measured.surfaces),
)
