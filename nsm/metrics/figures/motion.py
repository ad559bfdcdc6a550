"""How far the surface moves, and how evenly over time."""

from __future__ import annotations

from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import LENGTH, RATIO, RELATIVE

DISTANCE = MorphMetric(
    name="distance moved",
    unit=LENGTH,
    meaning="mean distance that the surface moves along its normal from t = 0 to 1",
    section=Section.MOTION,
    ideal=None,
    compute=lambda measured: measured.motion.distance,
)
UNEVENNESS = MorphMetric(
    name="speed max/mean",
    unit=RATIO,
    meaning="greatest over mean speed of the surface: 1 for a motion of constant speed",
    section=Section.MOTION,
    ideal=1.0,
    compute=lambda measured: measured.motion.unevenness,
)
MIDDLE_SHARE = MorphMetric(
    name="motion in middle half",
    unit=RELATIVE,
    meaning="part of the motion between t = 1/4 and 3/4: 0.5 for a motion of constant speed",
    section=Section.MOTION,
    ideal=None,
    compute=lambda measured: measured.motion.middle_share,
)
