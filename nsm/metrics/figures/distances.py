"""Distances between the surface of the morph and that of the shape at each end."""

from __future__ import annotations

from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import KeyMetric, Section
from nsm.metrics.unit import LENGTH


@KeyMetric.define("morph to shape", LENGTH, Section.ENDS)
def morph_to_shape(measured: Measurements, time: float) -> float:
    """Mean distance from the morph's surface to the shape's."""
    return measured.key(time).morph_to_shape.mean


@KeyMetric.define("morph to shape 99%", LENGTH, Section.ENDS)
def morph_to_shape_99(measured: Measurements, time: float) -> float:
    """99th percentile of the distance from the morph's surface to the shape's."""
    return measured.key(time).morph_to_shape.percentile_99


@KeyMetric.define("morph to shape max", LENGTH, Section.ENDS)
def morph_to_shape_maximum(measured: Measurements, time: float) -> float:
    """Greatest distance from the morph's surface to the shape's."""
    return measured.key(time).morph_to_shape.maximum


@KeyMetric.define("shape to morph", LENGTH, Section.ENDS)
def shape_to_morph(measured: Measurements, time: float) -> float:
    """Mean distance from the shape's surface to the morph's."""
    return measured.key(time).shape_to_morph.mean


@KeyMetric.define("shape to morph 99%", LENGTH, Section.ENDS)
def shape_to_morph_99(measured: Measurements, time: float) -> float:
    """99th percentile of the distance from the shape's surface to the morph's."""
    return measured.key(time).shape_to_morph.percentile_99


@KeyMetric.define("shape to morph max", LENGTH, Section.ENDS)
def shape_to_morph_maximum(measured: Measurements, time: float) -> float:
    """Greatest distance from the shape's surface to the morph's."""
    return measured.key(time).shape_to_morph.maximum


@KeyMetric.define("chamfer", LENGTH, Section.ENDS, heading="distance")
def chamfer(measured: Measurements, time: float) -> float:
    """Mean of the two mean distances."""
    return measured.key(time).chamfer


@KeyMetric.define("hausdorff", LENGTH, Section.ENDS)
def hausdorff(measured: Measurements, time: float) -> float:
    """Greatest distance from a point of either surface to the other."""
    return measured.key(time).hausdorff
