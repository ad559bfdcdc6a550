"""Volume at the ends, and how far it deviates from the wanted volume in between."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import EndMetric, MorphMetric, Section
from nsm.metrics.unit import FILE_VOLUME, RELATIVE


def _in_file_units(measured: Measurements, time: float) -> float | None:
    factor = measured.file_volume
    return None if factor is None else float(measured.volume.volumes[0 if time == 0 else -1]) * factor


VOLUME = EndMetric(
    name="volume",
    unit=FILE_VOLUME,
    meaning="volume (area in 2D) of the morph, in the units of the source's file",
    section=Section.VOLUME,
    ideal=None,
    compute=_in_file_units,
)
STD = MorphMetric(
    name="volume std",
    unit=RELATIVE,
    meaning="standard deviation over time of V(t) over the wanted volume, which is V(0) without growth",
    section=Section.VOLUME,
    heading="volume std",
    compute=lambda measured: measured.volume.relative_std,
)
MAXIMUM = MorphMetric(
    name="volume max",
    unit=RELATIVE,
    meaning="greatest |V(t) / wanted volume - 1|",
    section=Section.VOLUME,
    heading="volume max",
    compute=lambda measured: measured.volume.maximum_deviation,
)
ESTIMATOR_ERROR = MorphMetric(
    name="volume estimator error",
    unit=RELATIVE,
    meaning="greatest error of the measured volumes, estimated from two resolutions",
    section=Section.VOLUME,
    ideal=None,
    compute=lambda measured: measured.volume.relative_error,
)
