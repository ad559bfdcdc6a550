"""Position of the target relative to the source, before both get one volume and one place in the box."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.shapes.base import FieldShape
from nsm.shapes.registration import Candidate, register
from nsm.shapes.rotations import rotation_angles, rotation_generators
from nsm.shapes.similarity import Similarity

log = logging.getLogger(__name__)

#: A candidate fits as well as the best if its cost is below this multiple of the best one's, plus `_TIE_SLACK`. Among
#: those, the one that turns the target least from its pose is taken.
_TIE, _TIE_SLACK = 1.05, 1e-7
#: The same for a rotation that makes the alignment ambiguous; the costs are those of `nsm.shapes.registration`.
_RIVAL, _RIVAL_SLACK = 1.1, 2e-3
#: Rotations that differ by less than this angle in degrees do not make an alignment ambiguous.
_RIVAL_ANGLE = 10.0
#: Ratio of two sizes above which two files probably have different units.
_UNITS_DIFFER = 4.0
#: Angle in degrees up to which rounding may turn two poses that are the same.
_SAME_ORIENTATION = 1e-3


class Aligned(NamedTuple):
    """A target placed relative to its source.

    Attributes:
        target: The target, moved; its ``similarity`` still starts from the coordinates of its file.
        provenance: How it was placed, as values that JSON can hold: ``kind``; and but for ``none``, ``transformation``,
            the similarity from the coordinates of the target's file to those of the source's file.
    """

    target: FieldShape
    provenance: dict[str, Any]


class Alignment(ABC):
    """A way to place the target relative to the source, which stays where its pose puts it."""

    @abstractmethod
    def __call__(self, source: FieldShape, target: FieldShape) -> Aligned:
        """Place the target.

        Args:
            source: Shape in the coordinates of its pose.
            target: The same; of the same dimension.
        """


class Unaligned(Alignment):
    """Leaves both shapes where their poses put them, which is each about its own center if they are fitted."""

    def __call__(self, source: FieldShape, target: FieldShape) -> Aligned:
        return Aligned(target, {"kind": "none"})


class SharedCoordinates(Alignment):
    """Keeps the coordinates that two files share, as two scans of one patient do: one similarity serves both.

    The target takes the similarity of the source, so that the relative place, orientation, and size of the files'
    contents remain.
    """

    def __call__(self, source: FieldShape, target: FieldShape) -> Aligned:
        """Place the target.

        Raises:
            InputError: If a shape does not come from a file, or the two are posed with different orientations.
        """
        for end, shape in (("source", source), ("target", target)):
            if "path" not in shape.provenance():
                raise InputError(
                    f"`{end}` must be a file with align=shared, got a {shape.provenance()['kind']}. Try `align=none`, "
                    "which keeps the relative place of shapes that are given by formulas."
                )
        turn = source.similarity.rotation.T @ target.similarity.rotation
        if (angle := float(rotation_angles(turn[None])[0])) > _SAME_ORIENTATION:
            raise InputError(
                "`up` and `pose.rotation` of source and target must be the same with align=shared, got orientations "
                f"that differ by {angle:.3g} degrees. Try `align=rigid`, or give both shapes the same values."
            )
        moved = target.transformed(source.similarity.after(target.similarity.inverse()))
        _warn_if_apart(source, moved)
        return Aligned(moved, {"kind": "shared", "transformation": Similarity.identity(source.dim).to_config()})


class RigidAlignment(Alignment):
    """Turns and shifts the target so that its surface lies closest to the source's, at the scale of both files.

    The search covers all rotations (`nsm.shapes.registration`); there are no reflections. If several rotations fit
    equally well, as for symmetric shapes, it takes the one closest to the pose of the target and says so.
    """

    def __call__(self, source: FieldShape, target: FieldShape) -> Aligned:
        to_source, to_target = _from_file(source), _from_file(target)
        ratio = _longest_side(source) / source.similarity.scale / (_longest_side(target) / target.similarity.scale)
        if not 1 / _UNITS_DIFFER < ratio < _UNITS_DIFFER:
            log.warning(
                "the source is %.3g times as large as the target, in the units of their files: align=similarity fits "
                "the scale too",
                ratio,
            )
        return _aligned("rigid", source, target, to_source.scale / to_target.scale, rotation_generators(source.dim))


class SimilarityAlignment(Alignment):
    """Turns, shifts, and scales the target so that its surface lies closest to the source's.

    Like `RigidAlignment`, but for files whose units differ: the scale starts where both volumes are equal.
    """

    def __call__(self, source: FieldShape, target: FieldShape) -> Aligned:
        volumes = [shape.volume() / shape.placement.scale**shape.dim for shape in (source, target)]
        scale = (volumes[0] / volumes[1]) ** (1 / source.dim)
        growth = torch.eye(source.dim, dtype=torch.float64)[None]
        return _aligned("similarity", source, target, scale, torch.cat([rotation_generators(source.dim), growth]))


def _aligned(
    kind: str, source: FieldShape, target: FieldShape, scale: float, generators: Float[Tensor, "g d d"]
) -> Aligned:
    """Register a target to a source, report how well it fits, and move it.

    Args:
        kind: Name of the alignment.
        source: Shape that stays.
        target: Shape that is moved.
        scale: Scale from the local coordinates of the target to those of the source, to start from.
        generators: Of the linear maps that may be applied.
    """
    posed = source.placement.rotation.T @ target.placement.rotation
    start = Similarity(posed, torch.zeros(source.dim, dtype=torch.float64), scale)
    candidates = register(source, target, start, generators)
    best = min(candidate.cost for candidate in candidates)
    tied = [candidate for candidate in candidates if candidate.cost <= _TIE * best + _TIE_SLACK]
    chosen = min(tied, key=lambda candidate: _angle(posed, candidate))
    rivals = [
        angle
        for candidate in candidates
        if candidate.cost <= _RIVAL * chosen.cost + _RIVAL_SLACK
        and (angle := _angle(chosen.similarity.rotation, candidate)) > _RIVAL_ANGLE
    ]
    transformation = _from_file(source).inverse().after(chosen.similarity).after(_from_file(target))
    log.info(
        "aligned the target to the source (%s): turned by %.1f degrees%s; mean distance %.2g %% of the size",
        kind,
        _angle(posed, chosen),
        "" if kind == "rigid" else f", scaled by {transformation.scale:.5g} from file to file",
        100 * chosen.residual,
    )
    if rivals:
        log.warning(
            "the alignment is ambiguous: turned by a further %.0f degrees, the target fits as well, as symmetric "
            "shapes do. The rotation closest to its pose was taken; target.pose.rotation chooses another one",
            min(rivals),
        )
    onto = source.placement.after(chosen.similarity)
    return Aligned(
        target.transformed(onto.after(target.placement.inverse())),
        {
            "kind": kind,
            "transformation": transformation.to_config(),
            "residual": chosen.residual,
            "ambiguous": bool(rivals),
        },
    )


def _from_file(shape: FieldShape) -> Similarity:
    """Similarity from the coordinates of a shape's file to its local coordinates."""
    return shape.placement.inverse().after(shape.similarity)


def _angle(rotation: Float[Tensor, "d d"], candidate: Candidate) -> float:
    """Angle between two rotations in degrees."""
    return float(rotation_angles((rotation.T @ candidate.similarity.rotation)[None])[0])


def _longest_side(shape: FieldShape) -> float:
    low, high = shape.exact_bounds()
    return float((high - low).max())


def _warn_if_apart(source: FieldShape, target: FieldShape) -> None:
    """Warn if the bounding boxes of two shapes do not meet."""
    boxes = torch.stack([source.exact_bounds(), target.exact_bounds()])
    gap = float((boxes[:, 0].amax(0) - boxes[:, 1].amin(0)).max())
    if gap > 0:
        log.warning(
            "the two shapes lie apart in the coordinates that they share, by %.2g times the size of the source: with "
            "align=rigid, the target is moved to the source",
            gap / _longest_side(source),
        )
