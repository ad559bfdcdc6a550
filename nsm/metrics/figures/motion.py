"""How far the surface moves, and how evenly over time."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import LENGTH, RATIO, RELATIVE


@MorphMetric.define("distance moved", LENGTH, Section.MOTION, ideal=None)
def distance(measured: Measurements) -> float:
    """Mean distance that the surface moves along its normal from t = 0 to 1."""
    return measured.motion.distance


@MorphMetric.define("speed max/mean", RATIO, Section.MOTION, ideal=1.0)
def unevenness(measured: Measurements) -> float:
    """Greatest over mean speed of the surface: 1 for a motion of constant speed."""
    return measured.motion.unevenness


@MorphMetric.define("motion in middle half", RELATIVE, Section.MOTION, ideal=None)
def middle_share(measured: Measurements) -> float:
    """Part of the motion between t = 1/4 and 3/4: 0.5 for a motion of constant speed."""
    return measured.motion.middle_share
