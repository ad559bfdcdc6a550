"""Distance between the source surface as V advects it and the surface of f."""

from __future__ import annotations

from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import LENGTH

MEAN = MorphMetric(
    name="carried distance",
    unit=LENGTH,
    meaning="mean distance from the source surface advected by V to the surface of f, at the worst time",
    section=Section.ADVECTION,
    compute=lambda measured: None if measured.advection is None else measured.advection.mean_distance,
)
MAXIMUM = MorphMetric(
    name="carried distance max",
    unit=LENGTH,
    meaning="greatest distance from a vertex of the advected surface to the surface of f, at any time",
    section=Section.ADVECTION,
    compute=lambda measured: None if measured.advection is None else measured.advection.maximum_distance,
)
