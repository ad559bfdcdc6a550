"""Changes of topology over time."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import COUNT


@MorphMetric.define("topology events", COUNT, Section.TOPOLOGY, ideal=None, heading="changes of topology")
def events(measured: Measurements) -> float:
    """Changes of components or genus over time."""
    return len(measured.events)
