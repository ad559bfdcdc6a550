"""Volume of the morph against that of the shape at each end."""

from __future__ import annotations

from nsm.metrics.metric import EndMetric, Section
from nsm.metrics.unit import RELATIVE

VOLUME_ERROR = EndMetric(
    name="volume error",
    unit=RELATIVE,
    meaning="volume of the morph over that of the shape, minus 1",
    section=Section.ENDS,
    compute=lambda measured, time: measured.end(time).volume_error,
)
