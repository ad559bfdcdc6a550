"""Equal volumes: what a divergence-free motion between two shapes needs."""

from __future__ import annotations

import logging
from typing import NamedTuple

from nsm.errors import InputError
from nsm.shapes.base import FieldShape
from nsm.shapes.similarity import Similarity

log = logging.getLogger(__name__)


class EqualVolume(NamedTuple):
    """Two shapes of one volume, and the factors by which each was scaled about the origin to get there."""

    source: FieldShape
    target: FieldShape
    source_scale: float
    target_scale: float
    volume: float


def equal_volume(source: FieldShape, target: FieldShape) -> EqualVolume:
    """Scale the larger of two shapes down about the origin until both have the smaller volume.

    A uniform scale by s multiplies volumes by s^d, so s = (V_small / V_large)^(1/d), and the signed distance of the
    scaled shape is s g(x/s). (The paper's section 7 searches for s; this is its closed form.)

    Raises:
        InputError: if the shapes differ in dimension, or one has no volume.
    """
    if source.dim != target.dim:
        raise InputError(
            f"The source is {source.dim}D and the target {target.dim}D: name two shapes of the same dimension."
        )
    volumes = source.volume(), target.volume()
    for shape, value in zip((source, target), volumes, strict=True):
        if not value > 0:
            raise InputError(f"The {shape.provenance()['kind']} has volume {value:g}: give a shape with an inside.")
    small = min(volumes)
    scales = [(small / value) ** (1 / source.dim) for value in volumes]
    log.info("volumes %.5g and %.5g: scaled by %.5f and %.5f", *volumes, *scales)
    shapes = [
        shape if scale == 1 else shape.transformed(Similarity.scaling(scale, shape.dim))
        for shape, scale in zip((source, target), scales, strict=True)
    ]
    return EqualVolume(shapes[0], shapes[1], scales[0], scales[1], small)
