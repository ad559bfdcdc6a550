"""Timing of a film: which time t of a morph is seen at which film time s, and the morph seen so.

A `Timing` is a nondecreasing map from [0, 1] to [0, 1] with t(0) = 0 and t(1) = 1. `Retimed` is a morph that
follows it.
"""

from nsm.morphs.timing.base import Time, Timing
from nsm.morphs.timing.ease_in import EaseIn
from nsm.morphs.timing.ease_out import EaseOut
from nsm.morphs.timing.retimed import Retimed
from nsm.morphs.timing.smooth import Smooth
from nsm.morphs.timing.table import Table

__all__ = ["EaseIn", "EaseOut", "Retimed", "Smooth", "Table", "Time", "Timing"]
