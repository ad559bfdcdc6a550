"""Error of the flow maps that carry the detail of exact ends through time."""

from __future__ import annotations

from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import LENGTH

MEAN = MorphMetric(
    name="flow map",
    unit=LENGTH,
    meaning="mean deviation of the flow maps of V from direct integration",
    section=Section.EXACT_ENDS,
    compute=lambda measured: None if measured.flow is None else measured.flow.mean,
)
MAXIMUM = MorphMetric(
    name="flow map max",
    unit=LENGTH,
    meaning="greatest deviation of the flow maps of V from direct integration",
    section=Section.EXACT_ENDS,
    compute=lambda measured: None if measured.flow is None else measured.flow.maximum,
)
DETAIL = MorphMetric(
    name="carried detail",
    unit=LENGTH,
    meaning="mean error of f that follows from that of the flow maps, on the surface between the ends",
    section=Section.EXACT_ENDS,
    compute=lambda measured: None if measured.flow is None else measured.flow.field,
)
