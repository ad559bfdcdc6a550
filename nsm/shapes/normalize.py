"""The pair in the box: equal volumes, which a divergence-free motion needs, and one common size and place."""

from __future__ import annotations

import logging
from typing import NamedTuple

import torch

from nsm.cli.errors import InputError
from nsm.shapes.base import FieldShape
from nsm.shapes.similarity import Similarity

log = logging.getLogger(__name__)

#: Half of the longest side of the box around both shapes after `place_together`: the pair fills [-1, 1]^d, and leaves
#: a margin for what moves between them.
HALF_SIDE = 0.9


class EqualVolume(NamedTuple):
    """Two shapes of one volume, and the factors by which each was scaled, about its own center, to get there."""

    source: FieldShape
    target: FieldShape
    source_scale: float
    target_scale: float
    volume: float


class PlacedPair(NamedTuple):
    """Two shapes that fill the box together, and the similarity that brought both there."""

    source: FieldShape
    target: FieldShape
    similarity: Similarity


def equal_volume(source: FieldShape, target: FieldShape) -> EqualVolume:
    """Scale the larger of two shapes down, about the center of its bounding box, to the volume of the smaller.

    A uniform scale by s multiplies volumes by s^d, so s = (V_small / V_large)^(1/d), and the signed distance of the
    scaled shape is s g(x/s). (The paper's section 7 searches for s; this is its closed form.)

    Raises:
        InputError: if the shapes differ in dimension, or one has no volume.
    """
    _require_one_dimension(source, target)
    volumes = source.volume(), target.volume()
    for shape, value in zip((source, target), volumes, strict=True):
        if not value > 0:
            raise InputError(
                f"The volume of the {shape.provenance()['kind']} must be positive, got {value:g}. Try a shape with an "
                "inside."
            )
    small = min(volumes)
    scales = [(small / value) ** (1 / source.dim) for value in volumes]
    log.info("volumes %.5g and %.5g: scaled by %.5f and %.5f", *volumes, *scales)
    shapes = [
        shape if scale == 1 else shape.transformed(Similarity.about(shape.exact_bounds().mean(0), scale))
        for shape, scale in zip((source, target), scales, strict=True)
    ]
    return EqualVolume(shapes[0], shapes[1], scales[0], scales[1], small)


def place_together(source: FieldShape, target: FieldShape) -> PlacedPair:
    """Move and scale two shapes alike, so that the box around both is centered and half its longest side `HALF_SIDE`.

    There is no rotation, and both take the same similarity: where they lie relative to each other stays as it is.

    Raises:
        InputError: if the shapes differ in dimension.
    """
    _require_one_dimension(source, target)
    boxes = torch.stack([source.exact_bounds(), target.exact_bounds()])
    union = torch.stack([boxes[:, 0].amin(0), boxes[:, 1].amax(0)])
    similarity = Similarity.centering(union, HALF_SIDE)
    log.info("both shapes scaled by %.5g to fill the box together", similarity.scale)
    return PlacedPair(source.transformed(similarity), target.transformed(similarity), similarity)


def _require_one_dimension(source: FieldShape, target: FieldShape) -> None:
    if source.dim != target.dim:
        raise InputError(
            f"The source is {source.dim}D and the target {target.dim}D: name two shapes of the same dimension."
        )
