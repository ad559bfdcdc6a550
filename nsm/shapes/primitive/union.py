"""Unions of primitives."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.shapes.base import FieldShape
from nsm.shapes.primitive.base import Primitive
from nsm.shapes.similarity import Pose


class Union(Primitive):
    """The union of primitives: the minimum of their signed distances.

    The distance is exact outside, and inside wherever the members do not overlap.

    Args:
        shapes: The members, in common coordinates and of the same dimension.
        pose: Rotation, translation, and scale applied to the whole.

    Raises:
        InputError: If there are no members, or they differ in dimension.

    Example:
        >>> import torch
        >>> from nsm.shapes import Ball, Union
        >>> two = Union([Ball(0.25, center=[-0.5, 0.0]), Ball(0.25, center=[0.5, 0.0])])
        >>> two(torch.tensor([[0.0, 0.0], [0.5, 0.0]]))
        tensor([ 0.2500, -0.2500])
    """

    def __init__(self, shapes: Sequence[Primitive], pose: Pose = None) -> None:
        self._members = list(shapes)
        dims = {shape.dim for shape in self._members}
        if len(dims) != 1:
            raise InputError(
                f"`shapes` must be one or more shapes of the same dimension, got dimensions {sorted(dims)}. Try "
                "`shape@source=cylinders` for an example."
            )
        super().__init__(dims.pop(), pose, {"shapes": self._members})

    def local_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return torch.stack([shape(p) for shape in self._members]).amin(0)

    def support(self, u: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return torch.stack([_posed_support(shape, u) for shape in self._members]).amax(0)

    def local_volume(self) -> float:
        """Add the volumes of the members if their bounding boxes are disjoint; otherwise measure on a grid."""
        boxes = [shape.bounds() for shape in self._members]
        if all(((a[1] <= b[0]) | (b[1] <= a[0])).any() for a, b in combinations(boxes, 2)):
            return sum(shape.volume() for shape in self._members)
        return FieldShape.volume(self) / self.placement.scale**self.dim

    def config(self) -> dict[str, Any]:
        """Return class, pose, and the configurations of the members."""
        return {**super().config(), "shapes": [shape.config() for shape in self._members]}

    def provenance(self) -> dict[str, Any]:
        """Return kind, similarity, and the provenance of the members."""
        return {**super().provenance(), "arguments": {"shapes": [shape.provenance() for shape in self._members]}}


def _posed_support(shape: Primitive, u: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    pose = shape.similarity
    return u @ pose.translation.to(u) + pose.scale * shape.support(u @ pose.rotation.to(u))
