"""How closely V carries the landmarks of the source to those of the target."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import LENGTH


@MorphMetric.define("landmark error", LENGTH, Section.ADVECTION)
def mean(measured: Measurements) -> float | None:
    """Mean distance between landmarks of the source advected by V and those of the target."""
    return None if measured.landmarks is None else float(measured.landmarks.mean())


@MorphMetric.define("landmark error max", LENGTH, Section.ADVECTION)
def maximum(measured: Measurements) -> float | None:
    """Greatest distance between a landmark of the source advected by V and that of the target."""
    return None if measured.landmarks is None else float(measured.landmarks.max())
