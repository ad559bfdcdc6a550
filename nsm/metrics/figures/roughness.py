"""Roughness of the moving surface: the mean angle between neighboring triangles."""

from __future__ import annotations

import math

from nsm.metrics import averages
from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import DEGREE, RATIO


@MorphMetric.define("roughness mean", DEGREE, Section.SURFACE, heading="roughness")
def mean(measured: Measurements) -> float:
    """Mean angle between neighboring triangles, mean over times."""
    return averages.mean(surface.roughness for surface in measured.surfaces)


@MorphMetric.define("roughness greatest", DEGREE, Section.SURFACE)
def greatest(measured: Measurements) -> float:
    """Mean angle between neighboring triangles, at the time when it is greatest."""
    return averages.greatest(surface.roughness for surface in measured.surfaces)


@MorphMetric.define("roughness at 1/2", RATIO, Section.SURFACE)
def at_half(measured: Measurements) -> float:
    """Roughness at the time nearest to 1/2 over the greater roughness of the two ends."""
    surfaces = measured.surfaces
    middle = min(surfaces, key=lambda surface: abs(surface.time - 0.5))
    ends = averages.greatest([surfaces[0].roughness, surfaces[-1].roughness])
    return middle.roughness / ends if ends > 0 else math.nan
