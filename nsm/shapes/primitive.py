"""Shapes with exact signed distances, in 2D and 3D.

The formulas are the classical ones (I. Quilez, "Distance functions", iquilezles.org): fold the point by the
symmetries of the shape, then measure to the simple thing that remains.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.shapes.base import FieldShape
from nsm.shapes.similarity import Similarity

Pose = Similarity | Mapping[str, Any] | None


class Primitive(FieldShape):
    """A shape given by a formula.

    A subclass gives the distance, the support function and the volume in its own coordinates, and its arguments.
    """

    def __init__(self, dim: int, pose: Pose, arguments: dict[str, Any]) -> None:
        if dim not in (2, 3):
            raise InputError(f"A {type(self).__name__} was given in {dim} dimensions: shapes are 2D or 3D.")
        super().__init__(dim, Similarity.read(pose, dim))
        self._arguments = arguments

    @abstractmethod
    def support(self, u: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Support function max ⟨u, p⟩ over the points p of the shape, for unit directions u (n, d)."""

    @abstractmethod
    def own_volume(self) -> float:
        """Volume (area in 2D) in the shape's own coordinates."""

    def config(self) -> dict[str, Any]:
        """Class, arguments and pose; the state is empty."""
        return {
            "_target_": f"nsm.shapes.{type(self).__name__}",
            **self._arguments,
            "pose": self.similarity.to_config(),
        }

    def own_box(self) -> Float[Tensor, "2 d"]:
        """The exact bounds in own coordinates with a margin of 5 % of the longest side."""
        box = _support_box(self.support, torch.eye(self.dim, dtype=torch.float64))
        margin = 0.05 * float((box[1] - box[0]).max())
        return torch.stack([box[0] - margin, box[1] + margin]).to(torch.get_default_dtype())

    def exact_bounds(self) -> Float[Tensor, "2 d"]:
        """From the support function."""
        box = _support_box(self.support, self.similarity.rotation)
        return self.similarity.scale * box + self.similarity.translation

    def volume(self) -> float:
        """s^d times the closed form."""
        return self.similarity.scale**self.dim * self.own_volume()

    def provenance(self) -> dict[str, Any]:
        """The kind and its arguments."""
        return {
            "kind": type(self).__name__.lower(),
            "arguments": self._arguments,
            "similarity": self.similarity.to_config(),
        }


class Ball(Primitive):
    """A ball, in 2D a disk: |p − c| − r.

    Args:
        radius: r > 0.
        center: c, whose length gives the dimension.
        pose: rotation, translation and scale, done after.
    """

    def __init__(self, radius: float, center: Sequence[float] = (0, 0, 0), pose: Pose = None) -> None:
        self.radius, self.center = _positive("radius", radius), _floats(center)
        super().__init__(len(self.center), pose, {"radius": self.radius, "center": self.center})

    def own_distance(self, p: Tensor) -> Tensor:
        return (p - p.new_tensor(self.center)).norm(dim=1) - self.radius

    def support(self, u: Tensor) -> Tensor:
        return u @ u.new_tensor(self.center) + self.radius

    def own_volume(self) -> float:
        return math.pi * self.radius**2 if self.dim == 2 else 4 / 3 * math.pi * self.radius**3


class Box(Primitive):
    """A box, in 2D a rectangle: with q = |p − c| − size/2, the distance is |max(q, 0)| + min(max_i q_i, 0).

    Args:
        size: full side lengths, d of them.
        center: c.
        pose: rotation, translation and scale, done after.
    """

    def __init__(self, size: Sequence[float], center: Sequence[float] = (0, 0, 0), pose: Pose = None) -> None:
        self.size, self.center = [_positive("size", s) for s in size], _floats(center)
        if len(self.size) != len(self.center):
            raise InputError(
                f"A box has {len(self.size)} sides and a center of {len(self.center)} numbers: give d each."
            )
        super().__init__(len(self.size), pose, {"size": self.size, "center": self.center})

    def own_distance(self, p: Tensor) -> Tensor:
        q = (p - p.new_tensor(self.center)).abs() - p.new_tensor(self.size) / 2
        return _outside_and_inside(q)

    def support(self, u: Tensor) -> Tensor:
        return u @ u.new_tensor(self.center) + u.abs() @ u.new_tensor(self.size) / 2

    def own_volume(self) -> float:
        return math.prod(self.size)


class Cylinder(Primitive):
    """A capped cylinder along z: with q = (|p_xy − c_xy| − r, |p_z − c_z| − h/2), as a box in the half plane of q.

    Args:
        radius: r > 0.
        height: h > 0.
        center: c, three numbers.
        pose: rotation, translation and scale, done after.
    """

    def __init__(self, radius: float, height: float, center: Sequence[float] = (0, 0, 0), pose: Pose = None) -> None:
        self.radius, self.height = _positive("radius", radius), _positive("height", height)
        self.center = _floats(center)
        _only_3d(self, self.center)
        super().__init__(3, pose, {"radius": self.radius, "height": self.height, "center": self.center})

    def own_distance(self, p: Tensor) -> Tensor:
        p = p - p.new_tensor(self.center)
        q = torch.stack([p[:, :2].norm(dim=1) - self.radius, p[:, 2].abs() - self.height / 2], 1)
        return _outside_and_inside(q)

    def support(self, u: Tensor) -> Tensor:
        return u @ u.new_tensor(self.center) + self.radius * u[:, :2].norm(dim=1) + self.height / 2 * u[:, 2].abs()

    def own_volume(self) -> float:
        return math.pi * self.radius**2 * self.height


class Capsule(Primitive):
    """All points within r of a segment of length h along the last axis; in 2D a stadium.

    Args:
        radius: r > 0.
        height: h > 0, the length of the segment (so the shape is h + 2 r long).
        center: c, whose length gives the dimension.
        pose: rotation, translation and scale, done after.
    """

    def __init__(self, radius: float, height: float, center: Sequence[float] = (0, 0, 0), pose: Pose = None) -> None:
        self.radius, self.height = _positive("radius", radius), _positive("height", height)
        self.center = _floats(center)
        arguments = {"radius": self.radius, "height": self.height, "center": self.center}
        super().__init__(len(self.center), pose, arguments)

    def own_distance(self, p: Tensor) -> Tensor:
        p = p - p.new_tensor(self.center)
        along = (p[:, -1].abs() - self.height / 2).clamp(min=0)
        return torch.cat([p[:, :-1], along[:, None]], 1).norm(dim=1) - self.radius

    def support(self, u: Tensor) -> Tensor:
        return u @ u.new_tensor(self.center) + self.height / 2 * u[:, -1].abs() + self.radius

    def own_volume(self) -> float:
        r, h = self.radius, self.height
        return (math.pi * r + 2 * h) * r if self.dim == 2 else math.pi * r**2 * (4 / 3 * r + h)


class Torus(Primitive):
    """A torus around z: |(|p_xy − c_xy| − R, p_z − c_z)| − r.

    Args:
        major: R, from the centre to the middle of the tube.
        minor: r < R, radius of the tube.
        center: c, three numbers.
        pose: rotation, translation and scale, done after.
    """

    def __init__(self, major: float, minor: float, center: Sequence[float] = (0, 0, 0), pose: Pose = None) -> None:
        self.major, self.minor = _positive("major", major), _positive("minor", minor)
        self.center = _floats(center)
        _only_3d(self, self.center)
        if self.minor >= self.major:
            raise InputError(
                f"A torus of minor radius {self.minor:g} and major radius {self.major:g} cuts itself: "
                "give a minor radius below the major one."
            )
        super().__init__(3, pose, {"major": self.major, "minor": self.minor, "center": self.center})

    def own_distance(self, p: Tensor) -> Tensor:
        p = p - p.new_tensor(self.center)
        return torch.stack([p[:, :2].norm(dim=1) - self.major, p[:, 2]], 1).norm(dim=1) - self.minor

    def support(self, u: Tensor) -> Tensor:
        return u @ u.new_tensor(self.center) + self.major * u[:, :2].norm(dim=1) + self.minor

    def own_volume(self) -> float:
        return 2 * math.pi**2 * self.major * self.minor**2


class Polygon(Primitive):
    """A simple polygon in 2D: the distance to its nearest edge, negative where its winding number is odd.

    Args:
        vertices: corners in order, either way round, at least three.
        pose: rotation, translation and scale, done after.
    """

    def __init__(self, vertices: Sequence[Sequence[float]], pose: Pose = None) -> None:
        self.vertices = [_floats(v) for v in vertices]
        if len(self.vertices) < 3 or any(len(v) != 2 for v in self.vertices):
            raise InputError("A polygon needs at least three vertices of two numbers each, e.g. [[0,0],[1,0],[0,1]].")
        if self.own_volume() < 1e-9:
            raise InputError(f"The polygon {self.vertices} has no area: give corners that are not on one line.")
        super().__init__(2, pose, {"vertices": self.vertices})

    def own_distance(self, p: Tensor) -> Tensor:
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
        # beside an edge the signed height above it is the distance too, and has a gradient where it is zero
        height = -math.copysign(1, self._signed_area()) * (left / edge.norm(dim=1)).gather(1, nearest)[:, 0]
        beside = along.gather(1, nearest)[:, 0]
        return torch.where((beside > 0) & (beside < 1), height, torch.where(inside, -to_corner, to_corner))

    def support(self, u: Tensor) -> Tensor:
        return (u @ u.new_tensor(self.vertices).T).amax(1)

    def own_volume(self) -> float:
        return abs(self._signed_area())

    def _signed_area(self) -> float:
        """Area by the shoelace formula, positive if the corners go round counter-clockwise."""
        pairs = zip(self.vertices, self.vertices[1:] + self.vertices[:1], strict=True)
        return sum(ax * by - ay * bx for (ax, ay), (bx, by) in pairs) / 2


class Union(Primitive):
    """Several primitives as one shape: the least of their distances.

    The distance is exact outside, and inside wherever the members do not overlap.

    Args:
        shapes: the members, in common coordinates and of one dimension.
        pose: rotation, translation and scale of the whole, done after.
    """

    def __init__(self, shapes: Sequence[Primitive], pose: Pose = None) -> None:
        self._members = list(shapes)
        dims = {shape.dim for shape in self._members}
        if len(dims) != 1:
            raise InputError(
                f"A union of shapes in {sorted(dims) or 'no'} dimensions was given: name shapes of one dimension."
            )
        super().__init__(dims.pop(), pose, {"shapes": self._members})

    def own_distance(self, p: Tensor) -> Tensor:
        return torch.stack([shape(p) for shape in self._members]).amin(0)

    def support(self, u: Tensor) -> Tensor:
        return torch.stack([_posed_support(shape, u) for shape in self._members]).amax(0)

    def own_volume(self) -> float:
        """The sum where the boxes around the members are disjoint, else from the grid."""
        boxes = [shape.bounds() for shape in self._members]
        pairs = [(a, b) for i, a in enumerate(boxes) for b in boxes[:i]]
        if all(((a[1] <= b[0]) | (b[1] <= a[0])).any() for a, b in pairs):
            return sum(shape.volume() for shape in self._members)
        return FieldShape.volume(self) / self.placement.scale**self.dim

    def config(self) -> dict[str, Any]:
        """As of every primitive, with the configs of the members."""
        return {**super().config(), "shapes": [shape.config() for shape in self._members]}

    def provenance(self) -> dict[str, Any]:
        """As of every primitive, with the provenance of the members."""
        return {**super().provenance(), "arguments": {"shapes": [shape.provenance() for shape in self._members]}}


def _outside_and_inside(q: Tensor) -> Tensor:
    """Distance to a box from q = |p| − half sides: |max(q, 0)| + min(max_i q_i, 0)."""
    return q.clamp(min=0).norm(dim=1) + q.amax(1).clamp(max=0)


def _support_box(support: Any, rotation: Tensor) -> Tensor:
    """Bounds (2, d) of the rotated shape: support in the directions Rᵀ(±e_i)."""
    return torch.stack([-support(-rotation), support(rotation)])


def _posed_support(shape: Primitive, u: Tensor) -> Tensor:
    pose = shape.similarity
    return u @ pose.translation.to(u) + pose.scale * shape.support(u @ pose.rotation.to(u))


def _positive(name: str, value: float) -> float:
    value = float(value)
    if not 0 < value < math.inf:
        raise InputError(f"{name} is {value:g}, which leaves no volume: give a positive number.")
    return value


def _floats(values: Sequence[float]) -> list[float]:
    return [float(v) for v in values]


def _only_3d(shape: Primitive, center: list[float]) -> None:
    if len(center) != 3:
        raise InputError(
            f"A {type(shape).__name__.lower()} is 3D, but its center has {len(center)} numbers: give three."
        )
