"""Handles of the moving surface."""

from __future__ import annotations

from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import COUNT

MOST = MorphMetric(
    name="most handles",
    unit=COUNT,
    meaning="genus of the surface, all components together, at the time when it is greatest",
    section=Section.TOPOLOGY,
    ideal=None,
    compute=lambda measured: max(surface.genus for surface in measured.surfaces),
)
