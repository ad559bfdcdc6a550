"""Volume at the ends, and how far it deviates from the wanted volume in between."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import KeyMetric, MorphMetric, Section
from nsm.metrics.unit import FILE_VOLUME, RELATIVE


@KeyMetric.define("volume", FILE_VOLUME, Section.VOLUME, ideal=None)
def volume(measured: Measurements, time: float) -> float | None:
    """Volume (area in 2D) of the morph, in the units of the source's file."""
    factor = measured.file_volume
    return None if factor is None else float(measured.volume.volumes[measured.number(time)]) * factor


@MorphMetric.define("volume std", RELATIVE, Section.VOLUME, heading="volume std")
def std(measured: Measurements) -> float:
    """Standard deviation over time of V(t) over the wanted volume, which is V(0) without growth."""
    return measured.volume.relative_std


@MorphMetric.define("volume max", RELATIVE, Section.VOLUME, heading="volume max")
def maximum(measured: Measurements) -> float:
    """Greatest |V(t) / wanted volume − 1|."""
    return measured.volume.maximum_deviation


@MorphMetric.define("volume estimator error", RELATIVE, Section.VOLUME, ideal=None)
def estimator_error(measured: Measurements) -> float:
    """Greatest error of the measured volumes, estimated from two resolutions."""
    return measured.volume.relative_error
