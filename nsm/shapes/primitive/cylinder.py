"""Cylinders and capsules."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.settings import positive
from nsm.shapes.primitive.base import Primitive, box_distance, coordinates, require_3d
from nsm.shapes.similarity import Pose


class Cylinder(Primitive):
    """A capped cylinder along z.

    With q = (‖p_xy − c_xy‖ − r, |p_z − c_z| − h/2), the signed distance is ‖max(q, 0)‖ + min(max_i q_i, 0).

    Args:
        radius: Radius r > 0.
        height: Height h > 0.
        center: Center c, 3 coordinates.
        pose: Rotation, translation, and scale applied to the shape.

    Raises:
        InputError: If a length is not positive, or the center is not in 3D.

    References:
        Quilez, Distance Functions. https://iquilezles.org/articles/distfunctions/

    Example:
        >>> import torch
        >>> from nsm.shapes import Cylinder
        >>> Cylinder(radius=0.5, height=1.0)(torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 0.75]]))
        tensor([0.5000, 0.2500])
    """

    def __init__(self, radius: float, height: float, center: Sequence[float] = (0, 0, 0), pose: Pose = None) -> None:
        self.radius, self.height = positive("radius", radius, example=0.5), positive("height", height, example=0.5)
        self.center = coordinates(center)
        require_3d(self.center)
        super().__init__(3, pose, {"radius": self.radius, "height": self.height, "center": self.center})

    def local_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        p = p - p.new_tensor(self.center)
        return box_distance(torch.stack([p[:, :2].norm(dim=1) - self.radius, p[:, 2].abs() - self.height / 2], 1))

    def support(self, u: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return u @ u.new_tensor(self.center) + self.radius * u[:, :2].norm(dim=1) + self.height / 2 * u[:, 2].abs()

    def local_volume(self) -> float:
        return math.pi * self.radius**2 * self.height


class Capsule(Primitive):
    """All points within distance r of a segment of length h along the last axis; a stadium in 2D.

    Args:
        radius: Radius r > 0.
        height: Length h > 0 of the segment; the shape is h + 2 r long.
        center: Center c, whose number of coordinates determines the dimension.
        pose: Rotation, translation, and scale applied to the shape.

    Raises:
        InputError: If a length is not positive.

    References:
        Quilez, Distance Functions. https://iquilezles.org/articles/distfunctions/

    Example:
        >>> import torch
        >>> from nsm.shapes import Capsule
        >>> Capsule(radius=0.25, height=0.5)(torch.tensor([[0.0, 0.0, 1.0]]))
        tensor([0.5000])
    """

    def __init__(self, radius: float, height: float, center: Sequence[float] = (0, 0, 0), pose: Pose = None) -> None:
        self.radius, self.height = positive("radius", radius, example=0.5), positive("height", height, example=0.5)
        self.center = coordinates(center)
        arguments = {"radius": self.radius, "height": self.height, "center": self.center}
        super().__init__(len(self.center), pose, arguments)

    def local_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        p = p - p.new_tensor(self.center)
        beyond = (p[:, -1].abs() - self.height / 2).clamp(min=0)
        return torch.cat([p[:, :-1], beyond[:, None]], 1).norm(dim=1) - self.radius

    def support(self, u: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return u @ u.new_tensor(self.center) + self.height / 2 * u[:, -1].abs() + self.radius

    def local_volume(self) -> float:
        r, h = self.radius, self.height
        return (math.pi * r + 2 * h) * r if self.dim == 2 else math.pi * r**2 * (4 / 3 * r + h)
