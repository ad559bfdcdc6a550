"""Similarities x ↦ s R x + t: the poses of shapes, and the road from file coordinates to the box."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from kornia.geometry.conversions import angle_to_rotation_matrix, axis_angle_to_rotation_matrix
from torch import Tensor

from nsm.cli.errors import InputError

#: How far R Rᵀ may be from the identity before a matrix typed by a person is refused.
_ORTHOGONAL = 1e-4


@dataclass(frozen=True)
class Similarity:
    """A rotation, then a uniform scale, then a translation: x ↦ s R x + t, kept in float64.

    Args:
        rotation: R, orthogonal (d, d).
        translation: t (d,).
        scale: s > 0.
    """

    rotation: Float[Tensor, "d d"]
    translation: Float[Tensor, " d"]
    scale: float = 1.0

    @staticmethod
    def identity(dim: int) -> Similarity:
        """The similarity that moves nothing."""
        return Similarity(torch.eye(dim, dtype=torch.float64), torch.zeros(dim, dtype=torch.float64))

    @staticmethod
    def scaling(scale: float, dim: int) -> Similarity:
        """x ↦ s x."""
        return Similarity(torch.eye(dim, dtype=torch.float64), torch.zeros(dim, dtype=torch.float64), scale)

    @staticmethod
    def shift(translation: Float[Tensor, " d"]) -> Similarity:
        """x ↦ x + t."""
        return Similarity(torch.eye(len(translation), dtype=torch.float64), translation.double())

    @staticmethod
    def centering(bounds: Float[Tensor, "2 d"], half_side: float) -> Similarity:
        """Moves the center of a box (2, d) to the origin, and makes half of its longest side ``half_side``."""
        low, high = bounds.double()
        scale = 2 * half_side / float((high - low).max())
        return Similarity(torch.eye(len(low), dtype=torch.float64), -scale * (low + high) / 2, scale)

    @staticmethod
    def about(center: Float[Tensor, " d"], scale: float) -> Similarity:
        """x ↦ c + s (x − c)."""
        return Similarity(torch.eye(len(center), dtype=torch.float64), (1 - scale) * center.double(), scale)

    @staticmethod
    def upright(up: Sequence[float] | None, dim: int) -> Similarity:
        """The shortest rotation that turns a direction into +y, as people type it; none if it is None.

        Args:
            up: d numbers, in the coordinates of a file.
            dim: the dimension d.

        Raises:
            InputError: if ``up`` is no direction.
        """
        if up is None:
            return Similarity.identity(dim)
        direction = torch.tensor(_numbers(up), dtype=torch.float64)
        if direction.shape != (dim,) or not direction.isfinite().all() or not direction.any():
            raise InputError(
                f"`up` must be {dim} numbers that are not all zero, got {list(up)}. Try `up={[0, 1, 0][:dim]}`."
            )
        direction = direction / direction.norm()
        y = torch.eye(dim, dtype=torch.float64)[1]
        if direction @ y < -1 + 1e-12:  # upside down: half a turn in the plane of x and y
            half_turn = torch.eye(dim, dtype=torch.float64)
            half_turn[0, 0] = half_turn[1, 1] = -1
            return Similarity(half_turn, torch.zeros(dim, dtype=torch.float64))
        skew = torch.outer(y, direction) - torch.outer(direction, y)
        rotation = torch.eye(dim, dtype=torch.float64) + skew + skew @ skew / (1 + direction @ y)
        return Similarity(rotation, torch.zeros(dim, dtype=torch.float64))

    @staticmethod
    def read(pose: Similarity | Mapping[str, Any] | None, dim: int) -> Similarity:
        """Read a pose as people type it.

        Args:
            pose: None, or a mapping with any of ``rotation`` (one angle in 2D, an axis-angle vector in 3D, both in
                degrees; or a full matrix), ``translation`` (d numbers) and ``scale`` (a positive number).
            dim: the dimension d.

        Raises:
            InputError: for a key or a number of values that does not fit.
        """
        if pose is None:
            return Similarity.identity(dim)
        if isinstance(pose, Similarity):
            return pose
        if unknown := set(pose) - {"rotation", "translation", "scale"}:
            raise InputError(
                f"A pose has no key {', '.join(sorted(map(repr, unknown)))}: it takes rotation (degrees), translation "
                "and scale, e.g. pose.rotation=[0,0,90]."
            )
        translation = torch.tensor(_numbers(pose.get("translation") or [0.0] * dim), dtype=torch.float64)
        scale = float(pose.get("scale", 1.0))
        if translation.shape != (dim,) or not translation.isfinite().all():
            raise InputError(
                f"pose.translation is {translation.tolist()}, but the shape is {dim}D: give {dim} finite numbers."
            )
        if not 0 < scale < math.inf:
            raise InputError(f"pose.scale is {scale:g}: give a positive number.")
        return Similarity(_rotation(pose.get("rotation"), dim), translation, scale)

    def apply(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """s R x + t at x (n, d), in the type of x."""
        return self.scale * x @ self.rotation.to(x).T + self.translation.to(x)

    def pull_back(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """The inverse, Rᵀ (x − t) / s, at x (n, d)."""
        return (x - self.translation.to(x)) @ self.rotation.to(x) / self.scale

    def turn(self, normals: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """R n: what happens to directions (n, d)."""
        return normals @ self.rotation.to(normals).T

    def after(self, first: Similarity) -> Similarity:
        """The similarity that does ``first`` and then this one."""
        return Similarity(
            self.rotation @ first.rotation,
            self.scale * self.rotation @ first.translation + self.translation,
            self.scale * first.scale,
        )

    def inverse(self) -> Similarity:
        """The similarity that undoes this one."""
        back = self.rotation.T
        return Similarity(back, -back @ self.translation / self.scale, 1 / self.scale)

    def to_config(self) -> dict[str, Any]:
        """Plain numbers that `read` turns into the same similarity, bit for bit."""
        return {"rotation": self.rotation.tolist(), "translation": self.translation.tolist(), "scale": self.scale}


def _numbers(values: Any) -> list[Any]:
    """Nested lists of floats from what a config holds: a number, or a list of numbers or of lists."""
    if isinstance(values, (int, float)):
        return [float(values)]
    if isinstance(values, str) or not all(isinstance(v, (int, float, Sequence)) for v in values):
        raise InputError(f"{values!r} was given where a pose takes numbers: e.g. pose.rotation=[0,0,90].")
    return [float(v) if isinstance(v, (int, float)) else _numbers(v) for v in values]


def _rotation(rotation: Any, dim: int) -> Tensor:
    """Rotation matrix (d, d) from an angle, an axis-angle vector (degrees) or a matrix."""
    if rotation is None:
        return torch.eye(dim, dtype=torch.float64)
    values = torch.tensor(_numbers(rotation), dtype=torch.float64)
    if values.shape == (dim, dim):
        deviation = float((values @ values.T - torch.eye(dim, dtype=torch.float64)).abs().max())
        if deviation > _ORTHOGONAL or values.det() < 0:
            raise InputError(f"pose.rotation is a matrix that is no rotation: {values.tolist()}; give degrees instead.")
        return values
    if dim == 2 and values.shape == (1,) and values.isfinite().all():
        return angle_to_rotation_matrix(-values)[0]  # kornia turns clockwise
    if dim == 3 and values.shape == (3,) and values.isfinite().all():
        if not values.any():
            return torch.eye(3, dtype=torch.float64)
        return axis_angle_to_rotation_matrix(torch.deg2rad(values)[None])[0]
    wanted = "one angle in degrees" if dim == 2 else "three numbers, the axis times the angle in degrees"
    raise InputError(f"pose.rotation is {values.tolist()}, but the shape is {dim}D: give {wanted}.")
