"""Boxes and rectangles."""

from __future__ import annotations

import math
from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.cli.settings import positive
from nsm.shapes.primitive.base import Primitive, box_distance, coordinates
from nsm.shapes.similarity import Pose


class Box(Primitive):
    """A box, or a rectangle in 2D, with signed distance ‖max(q, 0)‖ + min(max_i q_i, 0), where q = |p − c| − size/2.

    Args:
        size: Side lengths, d of them.
        center: Center c, d coordinates.
        pose: Rotation, translation, and scale applied to the shape.

    Raises:
        InputError: If a side is not positive, or ``size`` and ``center`` differ in dimension.

    References:
        Quilez, Distance Functions. https://iquilezles.org/articles/distfunctions/

    Example:
        >>> import torch
        >>> from nsm.shapes import Box
        >>> Box(size=[1.0, 2.0], center=[0.0, 0.0])(torch.tensor([[1.0, 0.0], [0.0, 0.5]]))
        tensor([ 0.5000, -0.5000])
    """

    def __init__(self, size: Sequence[float], center: Sequence[float] = (0, 0, 0), pose: Pose = None) -> None:
        self.size, self.center = [positive("size", s, example=0.5) for s in size], coordinates(center)
        if len(self.size) != len(self.center):
            raise InputError(
                f"`size` and `center` must have the same dimension, got {len(self.size)} and {len(self.center)} "
                f"numbers. Try `center={[0] * len(self.size)}`."
            )
        super().__init__(len(self.size), pose, {"size": self.size, "center": self.center})

    def local_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return box_distance((p - p.new_tensor(self.center)).abs() - p.new_tensor(self.size) / 2)

    def support(self, u: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return u @ u.new_tensor(self.center) + u.abs() @ u.new_tensor(self.size) / 2

    def local_volume(self) -> float:
        return math.prod(self.size)
