"""Normalization of a pair of shapes: equal volumes, and a common position and size in the box."""

from __future__ import annotations

import logging
from typing import NamedTuple

import torch

from nsm.cli.errors import InputError
from nsm.shapes.base import FieldShape
from nsm.shapes.similarity import Similarity

log = logging.getLogger(__name__)

#: Half the longest side of the bounding box of both shapes after `place_together`, which leaves a margin in [-1, 1]^d
#: for the motion between them.
HALF_SIDE = 0.9


class EqualVolume(NamedTuple):
    """Two shapes of equal volume.

    Attributes:
        source, target: The shapes.
        source_scale, target_scale: Factors by which each was scaled about its own center.
        volume: The common volume.
    """

    source: FieldShape
    target: FieldShape
    source_scale: float
    target_scale: float
    volume: float


class PlacedPair(NamedTuple):
    """Two shapes that fill the box together.

    Attributes:
        source, target: The shapes.
        similarity: The similarity applied to both.
    """

    source: FieldShape
    target: FieldShape
    similarity: Similarity


def equal_volume(source: FieldShape, target: FieldShape) -> EqualVolume:
    """Scale the larger of two shapes about the center of its bounding box to the volume of the smaller.

    Scaling by s multiplies volumes by s^d, so s = (V_small / V_large)^(1/d), and the signed distance of the scaled
    shape is s g(x/s) (paper, section 7 and eq. 15).

    Raises:
        InputError: If the shapes differ in dimension, or one has no volume.

    Example:
        >>> from nsm.shapes import Ball, Box, equal_volume
        >>> ends = equal_volume(Ball(0.5), Box([1.0, 1.0, 1.0]))
        >>> round(ends.volume, 4), round(ends.target_scale, 4)
        (0.5236, 0.806)
    """
    _require_one_dimension(source, target)
    volumes = source.volume(), target.volume()
    for shape, value in zip((source, target), volumes, strict=True):
        if not value > 0:
            raise InputError(
                f"The volume of the `{shape.provenance()['kind']}` must be positive, got {value:g}. Try a closed shape."
            )
    small = min(volumes)
    scales = [(small / value) ** (1 / source.dim) for value in volumes]
    log.info("scaled shapes of volumes %.5g and %.5g by %.5f and %.5f", *volumes, *scales)
    shapes = [
        shape if scale == 1 else shape.transformed(Similarity.about(shape.exact_bounds().mean(0), scale))
        for shape, scale in zip((source, target), scales, strict=True)
    ]
    return EqualVolume(shapes[0], shapes[1], scales[0], scales[1], small)


def place_together(source: FieldShape, target: FieldShape) -> PlacedPair:
    """Apply one similarity to two shapes that centers their common bounding box and scales it to `HALF_SIDE`.

    The similarity has no rotation, and the relative position of the shapes does not change.

    Raises:
        InputError: If the shapes differ in dimension.

    Example:
        >>> from nsm.shapes import Ball, place_together
        >>> pair = place_together(Ball(1.0, center=[-1.0, 0.0]), Ball(1.0, center=[1.0, 0.0]))
        >>> pair.similarity.scale
        0.45
    """
    _require_one_dimension(source, target)
    boxes = torch.stack([source.exact_bounds(), target.exact_bounds()])
    union = torch.stack([boxes[:, 0].amin(0), boxes[:, 1].amax(0)])
    similarity = Similarity.centering(union, HALF_SIDE)
    log.info("scaled both shapes by %.5g to fill the box", similarity.scale)
    return PlacedPair(source.transformed(similarity), target.transformed(similarity), similarity)


def _require_one_dimension(source: FieldShape, target: FieldShape) -> None:
    if source.dim != target.dim:
        raise InputError(
            f"`target` must have the dimension of `source`, got {target.dim}D for a source in {source.dim}D. Try "
            f"`shape@target={'disk' if source.dim == 2 else 'ball'}`."
        )
