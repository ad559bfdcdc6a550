"""Morphs whose volume changes: a morph of constant volume, seen at a scale that changes with time.

Shapes of different volumes are scaled to one volume, the morph between them is made there, and shown as
f̃(x, t) = α(t) f(x/α(t), t) (paper, section 7.4, equations 15 and 16), whose volume is α(t)^d times that of f. A
`Growth` determines α. Its relative volumes are α^d, so 1 is the volume at which the morph was made.
"""

from nsm.morphs.growth.base import UNSCALED, Growth
from nsm.morphs.growth.grown import Grown
from nsm.morphs.growth.scale_linear import ScaleLinear
from nsm.morphs.growth.smooth_step import SmoothStep
from nsm.morphs.growth.table import Table
from nsm.morphs.growth.volume_linear import VolumeLinear

__all__ = ["UNSCALED", "Grown", "Growth", "ScaleLinear", "SmoothStep", "Table", "VolumeLinear"]
