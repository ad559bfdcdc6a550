"""Tori."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.cli.settings import positive
from nsm.shapes.primitive.base import Primitive, coordinates, require_3d
from nsm.shapes.similarity import Pose


class Torus(Primitive):
    """A torus around z, with signed distance ‖(‖p_xy − c_xy‖ − R, p_z − c_z)‖ − r.

    Args:
        major: Major radius R, from the center to the middle of the tube.
        minor: Minor radius r < R of the tube.
        center: Center c, 3 coordinates.
        pose: Rotation, translation, and scale applied to the shape.

    Raises:
        InputError: If a radius is not positive, the torus intersects itself, or the center is not in 3D.

    References:
        Quilez, Distance Functions. https://iquilezles.org/articles/distfunctions/

    Example:
        >>> import torch
        >>> from nsm.shapes import Torus
        >>> Torus(major=0.5, minor=0.2)(torch.tensor([[0.5, 0.0, 0.0]]))
        tensor([-0.2000])
    """

    def __init__(self, major: float, minor: float, center: Sequence[float] = (0, 0, 0), pose: Pose = None) -> None:
        self.major, self.minor = positive("major", major, example=0.5), positive("minor", minor, example=0.5)
        self.center = coordinates(center)
        require_3d(self.center)
        if self.minor >= self.major:
            raise InputError(
                f"`minor` must be less than `major` so that the torus does not intersect itself, got {self.minor:g} "
                f"and {self.major:g}. Try `minor={self.major / 3:.2g}`."
            )
        super().__init__(3, pose, {"major": self.major, "minor": self.minor, "center": self.center})

    def local_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        p = p - p.new_tensor(self.center)
        return torch.stack([p[:, :2].norm(dim=1) - self.major, p[:, 2]], 1).norm(dim=1) - self.minor

    def support(self, u: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return u @ u.new_tensor(self.center) + self.major * u[:, :2].norm(dim=1) + self.minor

    def local_volume(self) -> float:
        return 2 * math.pi**2 * self.major * self.minor**2
