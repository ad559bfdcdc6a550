"""Roughness of the moving surface: the mean angle between neighboring triangles."""

from __future__ import annotations

import math

from nsm.metrics.averages import greatest, mean
from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import DEGREE, RATIO


def _relative_to_ends(measured: Measurements) -> float:
    surfaces = measured.surfaces
    middle = min(surfaces, key=lambda surface: abs(surface.time - 0.5))
    ends = greatest([surfaces[0].roughness, surfaces[-1].roughness])
    return middle.roughness / ends if ends > 0 else math.nan


MEAN = MorphMetric(
    name="roughness mean",
    unit=DEGREE,
    meaning="mean angle between neighboring triangles, mean over times",
    section=Section.SURFACE,
    heading="roughness",
    compute=lambda measured: mean(surface.roughness for surface in measured.surfaces),
)
GREATEST = MorphMetric(
    name="roughness greatest",
    unit=DEGREE,
    meaning="mean angle between neighboring triangles, at the time when it is greatest",
    section=Section.SURFACE,
    compute=lambda measured: greatest(surface.roughness for surface in measured.surfaces),
)
AT_HALF = MorphMetric(
    name="roughness at 1/2",
    unit=RATIO,
    meaning="roughness at the time nearest to 1/2 over the greater roughness of the two ends",
    section=Section.SURFACE,
    compute=_relative_to_ends,
)
