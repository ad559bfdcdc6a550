"""Error of the flow maps that carry the detail of exact ends through time."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import LENGTH


@MorphMetric.define("flow map", LENGTH, Section.EXACT_ENDS)
def mean(measured: Measurements) -> float | None:
    """Mean deviation of the flow maps of V from direct integration."""
    return None if measured.flow is None else measured.flow.mean


@MorphMetric.define("flow map max", LENGTH, Section.EXACT_ENDS)
def maximum(measured: Measurements) -> float | None:
    """Greatest deviation of the flow maps of V from direct integration."""
    return None if measured.flow is None else measured.flow.maximum


@MorphMetric.define("carried detail", LENGTH, Section.EXACT_ENDS)
def detail(measured: Measurements) -> float | None:
    """Mean error of f that follows from that of the flow maps, on the surface between the ends."""
    return None if measured.flow is None else measured.flow.field
