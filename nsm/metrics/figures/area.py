"""Area of the moving surface (length in 2D)."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import AREA


@MorphMetric.define("area least", AREA, Section.SURFACE, ideal=None)
def least(measured: Measurements) -> float:
    """Area of the surface (length in 2D) at the time when it is least."""
    return min(surface.area for surface in measured.surfaces)


@MorphMetric.define("area greatest", AREA, Section.SURFACE, ideal=None)
def greatest(measured: Measurements) -> float:
    """Area of the surface (length in 2D) at the time when it is greatest."""
    return max(surface.area for surface in measured.surfaces)
