"""Source surface as V advects it: its volume, and its distance from the surface of f."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import LENGTH, RELATIVE


@MorphMetric.define("carried volume drift", RELATIVE, Section.ADVECTION)
def volume_drift(measured: Measurements) -> float | None:
    """Greatest |volume inside the source surface advected by V / wanted volume − 1|."""
    return None if measured.advection is None else measured.advection.drift


@MorphMetric.define("carried volume error", RELATIVE, Section.ADVECTION)
def volume_error(measured: Measurements) -> float | None:
    """Greatest error of the advected volumes, estimated from two grids."""
    return None if measured.advection is None else measured.advection.error


@MorphMetric.define("carried distance", LENGTH, Section.ADVECTION)
def distance(measured: Measurements) -> float | None:
    """Mean distance from the source surface advected by V to the surface of f, at the worst time."""
    return None if measured.advection is None else measured.advection.mean_distance


@MorphMetric.define("carried distance max", LENGTH, Section.ADVECTION)
def distance_maximum(measured: Measurements) -> float | None:
    """Greatest distance from a vertex of the advected surface to the surface of f, at any time."""
    return None if measured.advection is None else measured.advection.maximum_distance
