"""Handles of the moving surface."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import COUNT


@MorphMetric.define("most handles", COUNT, Section.TOPOLOGY, ideal=None)
def most(measured: Measurements) -> float:
    """Genus of the surface, all components together, at the time when it is greatest."""
    return max(surface.genus for surface in measured.surfaces)
