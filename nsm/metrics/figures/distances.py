"""Distances between the surface of the morph and that of the shape at each end."""

from __future__ import annotations

from nsm.metrics.metric import EndMetric, Section
from nsm.metrics.unit import LENGTH

MORPH_TO_SHAPE = EndMetric(
    name="morph to shape",
    unit=LENGTH,
    meaning="mean distance from the morph's surface to the shape's",
    section=Section.ENDS,
    compute=lambda measured, time: measured.end(time).morph_to_shape.mean,
)
MORPH_TO_SHAPE_99 = EndMetric(
    name="morph to shape 99%",
    unit=LENGTH,
    meaning="99th percentile of the distance from the morph's surface to the shape's",
    section=Section.ENDS,
    compute=lambda measured, time: measured.end(time).morph_to_shape.percentile_99,
)
MORPH_TO_SHAPE_MAXIMUM = EndMetric(
    name="morph to shape max",
    unit=LENGTH,
    meaning="greatest distance from the morph's surface to the shape's",
    section=Section.ENDS,
    compute=lambda measured, time: measured.end(time).morph_to_shape.maximum,
)
SHAPE_TO_MORPH = EndMetric(
    name="shape to morph",
    unit=LENGTH,
    meaning="mean distance from the shape's surface to the morph's",
    section=Section.ENDS,
    compute=lambda measured, time: measured.end(time).shape_to_morph.mean,
)
SHAPE_TO_MORPH_99 = EndMetric(
    name="shape to morph 99%",
    unit=LENGTH,
    meaning="99th percentile of the distance from the shape's surface to the morph's",
    section=Section.ENDS,
    compute=lambda measured, time: measured.end(time).shape_to_morph.percentile_99,
)
SHAPE_TO_MORPH_MAXIMUM = EndMetric(
    name="shape to morph max",
    unit=LENGTH,
    meaning="greatest distance from the shape's surface to the morph's",
    section=Section.ENDS,
    compute=lambda measured, time: measured.end(time).shape_to_morph.maximum,
)
CHAMFER = EndMetric(
    name="chamfer",
    unit=LENGTH,
    meaning="mean of the two mean distances",
    section=Section.ENDS,
    heading="distance",
    compute=lambda measured, time: measured.end(time).chamfer,
)
HAUSDORFF = EndMetric(
    name="hausdorff",
    unit=LENGTH,
    meaning="greatest distance from a point of either surface to the other",
    section=Section.ENDS,
    compute=lambda measured, time: measured.end(time).hausdorff,
)
