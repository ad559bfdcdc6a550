"""Area of the moving surface (length in 2D)."""

from __future__ import annotations

from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import AREA

LEAST = MorphMetric(
    name="area least",
    unit=AREA,
    meaning="area of the surface (length in 2D) at the time when it is least",
    section=Section.SURFACE,
    ideal=None,
    compute=lambda measured: min(surface.area for surface in measured.surfaces),
)
GREATEST = MorphMetric(
    name="area greatest",
    unit=AREA,
    meaning="area of the surface (length in 2D) at the time when it is greatest",
    section=Section.SURFACE,
    ideal=None,
    compute=lambda measured: max(surface.area for surface in measured.surfaces),
)
