"""Volume that leaves the box of the morph."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import RELATIVE


@MorphMetric.define("volume beyond", RELATIVE, Section.VOLUME)
def beyond(measured: Measurements) -> float:
    """Greatest volume outside the box over V(0), at times when the surface leaves the box."""
    return measured.volume_beyond
