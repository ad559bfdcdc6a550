"""Balls and disks."""

from __future__ import annotations

import math
from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from nsm.cli.settings import positive
from nsm.shapes.primitive.base import Primitive, coordinates
from nsm.shapes.similarity import Pose


class Ball(Primitive):
    """A ball, or a disk in 2D, with signed distance ‖p − c‖ − r.

    Args:
        radius: Radius r > 0.
        center: Center c, whose number of coordinates determines the dimension.
        pose: Rotation, translation, and scale applied to the shape.

    Raises:
        InputError: If the radius is not positive.

    Example:
        >>> import torch
        >>> from nsm.shapes import Ball
        >>> ball = Ball(radius=0.5)
        >>> ball(torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
        tensor([-0.5000,  0.5000])
        >>> round(ball.volume(), 4)
        0.5236
    """

    def __init__(self, radius: float, center: Sequence[float] = (0, 0, 0), pose: Pose = None) -> None:
        self.radius, self.center = positive("radius", radius, example=0.5), coordinates(center)
        super().__init__(len(self.center), pose, {"radius": self.radius, "center": self.center})

    def local_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return (p - p.new_tensor(self.center)).norm(dim=1) - self.radius

    def support(self, u: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return u @ u.new_tensor(self.center) + self.radius

    def local_volume(self) -> float:
        return math.pi * self.radius**2 if self.dim == 2 else 4 / 3 * math.pi * self.radius**3
