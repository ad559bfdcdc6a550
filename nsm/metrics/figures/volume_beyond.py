"""Volume that leaves the box of the morph."""

from __future__ import annotations

from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import RELATIVE

BEYOND = MorphMetric(
    name="volume beyond",
    unit=RELATIVE,
    meaning="greatest volume outside the box over V(0), at times when the surface leaves the box",
    section=Section.VOLUME,
    compute=lambda measured: measured.volume_beyond,
)
