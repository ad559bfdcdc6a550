"""Volume of the morph against that of the shape at each end."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import KeyMetric, Section
from nsm.metrics.unit import RELATIVE


@KeyMetric.define("volume error", RELATIVE, Section.ENDS)
def volume_error(measured: Measurements, time: float) -> float:
    """Volume of the morph over that of the shape, minus 1."""
    return measured.key(time).volume_error
