"""Volume that is lost and regained, or gained and lost again."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import RELATIVE


@MorphMetric.define("volume detour", RELATIVE, Section.VOLUME, heading="volume detour")
def detour(measured: Measurements) -> float:
    """Total variation of V(t) beyond |V(1) − V(0)|, over V(0): 0 where the volume only grows or only shrinks."""
    volumes = measured.volume.volumes
    beyond = volumes.diff().abs().sum() - (volumes[-1] - volumes[0]).abs()
    return float(beyond / volumes[0])
