"""Angle between the normals of the morph and of the shape at each end."""

from __future__ import annotations

from nsm.metrics.metric import EndMetric, Section
from nsm.metrics.unit import DEGREE

NORMAL_ERROR = EndMetric(
    name="normal error",
    unit=DEGREE,
    meaning="mean angle between the gradient of f and the normal of the shape",
    section=Section.ENDS,
    heading="normals",
    compute=lambda measured, time: measured.end(time).normal_error,
)
