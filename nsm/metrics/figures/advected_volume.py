"""Volume inside the source surface as V advects it."""

from __future__ import annotations

from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import RELATIVE

DRIFT = MorphMetric(
    name="carried volume drift",
    unit=RELATIVE,
    meaning="greatest |volume inside the source surface advected by V / wanted volume - 1|",
    section=Section.ADVECTION,
    compute=lambda measured: None if measured.advection is None else measured.advection.drift,
)
ERROR = MorphMetric(
    name="carried volume error",
    unit=RELATIVE,
    meaning="greatest error of the advected volumes, estimated from two meshes",
    section=Section.ADVECTION,
    compute=lambda measured: None if measured.advection is None else measured.advection.error,
)
