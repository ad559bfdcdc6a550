"""Normalization of the shapes of a morph: equal volumes, and a common position and size in the box."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import NamedTuple

import torch

from nsm.cli.errors import InputError
from nsm.shapes.base import FieldShape
from nsm.shapes.similarity import Similarity

log = logging.getLogger(__name__)

#: Half the longest side of the bounding box of all shapes after `place_together`, which leaves a margin in [-1, 1]^d
#: for the motion between them.
HALF_SIDE = 0.9


class EqualVolume(NamedTuple):
    """Shapes of equal volume.

    Attributes:
        shapes: The shapes.
        scales: Factors by which each was scaled about its own center.
        volume: The common volume.
    """

    shapes: tuple[FieldShape, ...]
    scales: tuple[float, ...]
    volume: float


class Placed(NamedTuple):
    """Shapes that fill the box together.

    Attributes:
        shapes: The shapes.
        similarity: The similarity applied to all of them.
    """

    shapes: tuple[FieldShape, ...]
    similarity: Similarity


def equal_volume(*shapes: FieldShape) -> EqualVolume:
    """Scale shapes about the centers of their bounding boxes to the volume of the smallest.

    Scaling by s multiplies volumes by s^d, so s = (V_small / V_large)^(1/d), and the signed distance of the scaled
    shape is s g(x/s) (paper, section 7 and eq. 15).

    Raises:
        InputError: If the shapes differ in dimension, or one has no volume.

    Example:
        >>> from nsm.shapes import Ball, Box, equal_volume
        >>> ends = equal_volume(Ball(0.5), Box([1.0, 1.0, 1.0]))
        >>> round(ends.volume, 4), round(ends.scales[1], 4)
        (0.5236, 0.806)
    """
    _require_one_dimension(shapes)
    volumes = [shape.volume() for shape in shapes]
    for shape, value in zip(shapes, volumes, strict=True):
        if not value > 0:
            raise InputError(
                f"The volume of the `{shape.provenance()['kind']}` must be positive, got {value:g}. Try a closed shape."
            )
    small = min(volumes)
    scales = tuple((small / value) ** (1 / shapes[0].dim) for value in volumes)
    log.info(
        "scaled shapes of volumes %s by %s",
        " and ".join(f"{value:.5g}" for value in volumes),
        " and ".join(f"{scale:.5f}" for scale in scales),
    )
    scaled = tuple(
        shape if scale == 1 else shape.transformed(Similarity.about(shape.exact_bounds().mean(0), scale))
        for shape, scale in zip(shapes, scales, strict=True)
    )
    return EqualVolume(scaled, scales, small)


def place_together(*shapes: FieldShape) -> Placed:
    """Apply one similarity to shapes that centers their common bounding box and scales it to `HALF_SIDE`.

    The similarity has no rotation, and the relative position of the shapes does not change.

    Raises:
        InputError: If the shapes differ in dimension.

    Example:
        >>> from nsm.shapes import Ball, place_together
        >>> pair = place_together(Ball(1.0, center=[-1.0, 0.0]), Ball(1.0, center=[1.0, 0.0]))
        >>> pair.similarity.scale
        0.45
    """
    _require_one_dimension(shapes)
    boxes = torch.stack([shape.exact_bounds() for shape in shapes])
    union = torch.stack([boxes[:, 0].amin(0), boxes[:, 1].amax(0)])
    similarity = Similarity.centering(union, HALF_SIDE)
    log.info("scaled all shapes by %.5g to fill the box", similarity.scale)
    return Placed(tuple(shape.transformed(similarity) for shape in shapes), similarity)


def _require_one_dimension(shapes: Sequence[FieldShape]) -> None:
    dim = shapes[0].dim
    for shape in shapes:
        if shape.dim != dim:
            raise InputError(
                f"Every shape must have the dimension of the first, {dim}D, got a {shape.provenance()['kind']} in "
                f"{shape.dim}D. Try `shape@target={'disk' if dim == 2 else 'ball'}`."
            )
