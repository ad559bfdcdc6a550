"""Polygons."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.shapes.primitive.base import Primitive, coordinates
from nsm.shapes.similarity import Pose

#: Smallest area of a polygon; below, its vertices are collinear.
_MIN_AREA = 1e-9


class Polygon(Primitive):
    """A simple polygon in 2D: the distance to the nearest edge, negative inside by the even-odd rule.

    Args:
        vertices: At least three vertices in order, clockwise or counterclockwise.
        pose: Rotation, translation, and scale applied to the shape.

    Raises:
        InputError: If there are fewer than three vertices, or they are collinear.

    References:
        Quilez, 2D Distance Functions. https://iquilezles.org/articles/distfunctions2d/

    Example:
        >>> import torch
        >>> from nsm.shapes import Polygon
        >>> triangle = Polygon([[0, 0], [1, 0], [0, 1]])
        >>> triangle(torch.tensor([[0.5, -0.25], [0.25, 0.25]]))
        tensor([ 0.2500, -0.2500])
    """

    def __init__(self, vertices: Sequence[Sequence[float]], pose: Pose = None) -> None:
        self.vertices = [coordinates(v) for v in vertices]
        if len(self.vertices) < 3 or any(len(v) != 2 for v in self.vertices):
            raise InputError(
                f"`vertices` must be at least three points of two coordinates each, got {self.vertices}. Try "
                "`vertices=[[0,0],[1,0],[0,1]]`."
            )
        if self.local_volume() < _MIN_AREA:
            raise InputError(
                f"`vertices` must not be collinear, got {self.vertices}, which enclose no area. Try "
                "`vertices=[[0,0],[1,0],[0,1]]`."
            )
        super().__init__(2, pose, {"vertices": self.vertices})

    def local_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        a = p.new_tensor(self.vertices)
        edge = a.roll(-1, 0) - a
        w = p[:, None] - a
        along = (w * edge).sum(2) / edge.square().sum(1)
        distances = (w - along.clamp(0, 1)[:, :, None] * edge).norm(dim=2)
        nearest = distances.argmin(1, keepdim=True)
        to_corner = distances.gather(1, nearest)[:, 0]
        # a ray in direction +x crosses an edge that spans the height of the point and lies to its right
        left = edge[:, 0] * w[:, :, 1] - edge[:, 1] * w[:, :, 0]
        spans = (w[:, :, 1] >= 0) != (w[:, :, 1] - edge[:, 1] >= 0)
        inside = (spans & (left * edge[:, 1].sign() > 0)).sum(1) % 2 == 1
        # where the foot lies within an edge, the signed height above it is the distance and is differentiable at zero
        height = -math.copysign(1, self._signed_area()) * (left / edge.norm(dim=1)).gather(1, nearest)[:, 0]
        foot = along.gather(1, nearest)[:, 0]
        return torch.where((foot > 0) & (foot < 1), height, torch.where(inside, -to_corner, to_corner))

    def support(self, u: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return (u @ u.new_tensor(self.vertices).T).amax(1)

    def local_volume(self) -> float:
        return abs(self._signed_area())

    def _signed_area(self) -> float:
        """Compute the area by the shoelace formula, positive if the vertices are counterclockwise."""
        edges = zip(self.vertices, self.vertices[1:] + self.vertices[:1], strict=True)
        return sum(ax * by - ay * bx for (ax, ay), (bx, by) in edges) / 2
