"""Similarities x ↦ s R x + t: poses of shapes, and maps from the coordinates of a file to the box."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from kornia.geometry.conversions import angle_to_rotation_matrix, axis_angle_to_rotation_matrix
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.cli.settings import positive

#: Maximum deviation of R Rᵀ from the identity for a rotation matrix in a configuration.
_ORTHOGONAL = 1e-4


@dataclass(frozen=True)
class Similarity:
    """A rotation, a uniform scale, and a translation, x ↦ s R x + t, in double precision.

    Args:
        rotation: Orthogonal matrix R, shape (d, d).
        translation: Vector t, shape (d,).
        scale: Factor s > 0.

    Example:
        >>> import torch
        >>> from nsm.shapes import Similarity
        >>> pose = Similarity.read({"rotation": [0, 0, 90], "scale": 2}, dim=3)
        >>> pose.apply(torch.tensor([[1.0, 0.0, 0.0]])).round(decimals=3).abs()
        tensor([[0., 2., 0.]])
    """

    rotation: Float[Tensor, "d d"]
    translation: Float[Tensor, " d"]
    scale: float = 1.0

    @staticmethod
    def identity(dim: int) -> Similarity:
        """Create the identity."""
        return Similarity(torch.eye(dim, dtype=torch.float64), torch.zeros(dim, dtype=torch.float64))

    @staticmethod
    def scaling(scale: float, dim: int) -> Similarity:
        """Create the map x ↦ s x."""
        return Similarity(torch.eye(dim, dtype=torch.float64), torch.zeros(dim, dtype=torch.float64), scale)

    @staticmethod
    def shift(translation: Float[Tensor, " d"]) -> Similarity:
        """Create the map x ↦ x + t."""
        return Similarity(torch.eye(len(translation), dtype=torch.float64), translation.double())

    @staticmethod
    def centering(bounds: Float[Tensor, "2 d"], half_side: float) -> Similarity:
        """Create the map that centers a box, shape (2, d), and scales half its longest side to ``half_side``."""
        low, high = bounds.double()
        scale = 2 * half_side / float((high - low).max())
        return Similarity(torch.eye(len(low), dtype=torch.float64), -scale * (low + high) / 2, scale)

    @staticmethod
    def about(center: Float[Tensor, " d"], scale: float) -> Similarity:
        """Create the map x ↦ c + s (x − c)."""
        return Similarity(torch.eye(len(center), dtype=torch.float64), (1 - scale) * center.double(), scale)

    @staticmethod
    def upright(up: Sequence[float] | None, dim: int) -> Similarity:
        """Create the smallest rotation that turns a direction to +y, or the identity if it is None.

        Args:
            up: Direction in the coordinates of a file, d numbers.
            dim: Dimension d.

        Raises:
            InputError: If ``up`` is not a direction in d dimensions.
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
        if direction @ y < -1 + 1e-12:  # upside down: a half turn in the xy-plane
            half_turn = torch.eye(dim, dtype=torch.float64)
            half_turn[0, 0] = half_turn[1, 1] = -1
            return Similarity(half_turn, torch.zeros(dim, dtype=torch.float64))
        skew = torch.outer(y, direction) - torch.outer(direction, y)
        rotation = torch.eye(dim, dtype=torch.float64) + skew + skew @ skew / (1 + direction @ y)
        return Similarity(rotation, torch.zeros(dim, dtype=torch.float64))

    @staticmethod
    def read(pose: Similarity | Mapping[str, Any] | None, dim: int) -> Similarity:
        """Create a similarity from a pose in a configuration.

        Args:
            pose: None, or a mapping with any of ``rotation`` (an angle in 2D or an axis-angle vector in 3D, both in
                degrees, or a matrix), ``translation`` (d numbers), and ``scale`` (a positive number).
            dim: Dimension d.

        Raises:
            InputError: If a key is unknown, or a value has the wrong type or dimension.
        """
        if pose is None:
            return Similarity.identity(dim)
        if isinstance(pose, Similarity):
            return pose
        if unknown := set(pose) - {"rotation", "translation", "scale"}:
            raise InputError(
                "`pose` must consist of rotation (in degrees), translation, and scale, got "
                f"{', '.join(sorted(map(repr, unknown)))}. Try `pose.rotation=[0,0,90]`."
            )
        translation = torch.tensor(_numbers(pose.get("translation") or [0.0] * dim), dtype=torch.float64)
        scale = positive("pose.scale", pose.get("scale", 1.0))
        if translation.shape != (dim,) or not translation.isfinite().all():
            raise InputError(
                f"`pose.translation` must be {dim} finite numbers, got {translation.tolist()}. Try "
                f"`pose.translation={[0] * dim}`."
            )
        return Similarity(_rotation(pose.get("rotation"), dim), translation, scale)

    def apply(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Map points, shape (n, d), to s R x + t, in their dtype."""
        return self.scale * x @ self.rotation.to(x).T + self.translation.to(x)

    def pull_back(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Apply the inverse, Rᵀ (x − t) / s, to points, shape (n, d)."""
        return (x - self.translation.to(x)) @ self.rotation.to(x) / self.scale

    def rotate(self, normals: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Map directions, shape (n, d), to R n."""
        return normals @ self.rotation.to(normals).T

    def after(self, first: Similarity) -> Similarity:
        """Compose this similarity with one that is applied first."""
        return Similarity(
            self.rotation @ first.rotation,
            self.scale * self.rotation @ first.translation + self.translation,
            self.scale * first.scale,
        )

    def inverse(self) -> Similarity:
        """Invert this similarity."""
        back = self.rotation.T
        return Similarity(back, -back @ self.translation / self.scale, 1 / self.scale)

    def to_config(self) -> dict[str, Any]:
        """Convert to plain numbers, from which `read` restores the same similarity bit for bit."""
        return {"rotation": self.rotation.tolist(), "translation": self.translation.tolist(), "scale": self.scale}


#: A pose as configurations contain it: see `Similarity.read`.
Pose = Similarity | Mapping[str, Any] | None


def _numbers(values: Any) -> list[Any]:
    """Convert a number, or a nested list of numbers, to nested lists of floats."""
    if isinstance(values, (int, float)):
        return [float(values)]
    if isinstance(values, str) or not all(isinstance(v, (int, float, Sequence)) for v in values):
        raise InputError(f"`pose` must consist of numbers, got {values!r}. Try `pose.rotation=[0,0,90]`.")
    return [float(v) if isinstance(v, (int, float)) else _numbers(v) for v in values]


def _rotation(rotation: Any, dim: int) -> Tensor:
    """Compute a rotation matrix, shape (d, d), from an angle or an axis-angle vector in degrees, or check a matrix."""
    if rotation is None:
        return torch.eye(dim, dtype=torch.float64)
    values = torch.tensor(_numbers(rotation), dtype=torch.float64)
    if values.shape == (dim, dim):
        deviation = float((values @ values.T - torch.eye(dim, dtype=torch.float64)).abs().max())
        if deviation > _ORTHOGONAL or values.det() < 0:
            raise InputError(
                f"`pose.rotation` must be a rotation matrix or angles in degrees, got {values.tolist()}, which is not "
                "a rotation. Try `pose.rotation=[0,0,90]`."
            )
        return values
    if dim == 2 and values.shape == (1,) and values.isfinite().all():
        return angle_to_rotation_matrix(-values)[0]  # kornia rotates clockwise
    if dim == 3 and values.shape == (3,) and values.isfinite().all():
        if not values.any():
            return torch.eye(3, dtype=torch.float64)
        return axis_angle_to_rotation_matrix(torch.deg2rad(values)[None])[0]
    wanted = "one angle in degrees" if dim == 2 else "three numbers, the axis times the angle in degrees,"
    example = "90" if dim == 2 else "[0,0,90]"
    raise InputError(
        f"`pose.rotation` must be {wanted} in {dim}D, got {values.tolist()}. Try `pose.rotation={example}`."
    )
