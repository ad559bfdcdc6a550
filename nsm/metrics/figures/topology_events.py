"""Changes of topology over time."""

from __future__ import annotations

from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import COUNT

EVENTS = MorphMetric(
    name="topology events",
    unit=COUNT,
    meaning="changes of components or genus over time",
    section=Section.TOPOLOGY,
    ideal=None,
    heading="changes of topology",
    compute=lambda measured: len(measured.events),
)
