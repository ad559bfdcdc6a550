"""Angle between the normals of the morph and of the shape at each end."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import KeyMetric, Section
from nsm.metrics.unit import DEGREE


@KeyMetric.define("normal error", DEGREE, Section.ENDS, heading="normals")
def normal_error(measured: Measurements, time: float) -> float:
    """Mean angle between the gradient of f and the normal of the shape."""
    return measured.key(time).normal_error
