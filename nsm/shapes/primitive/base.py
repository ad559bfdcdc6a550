"""The interface of shapes with exact signed distances."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.shapes.base import FieldShape
from nsm.shapes.similarity import Pose, Similarity

#: Margin of the local box around a shape, relative to its longest side.
_MARGIN = 0.05


class Primitive(FieldShape):
    """A shape given by a formula.

    A subclass provides the signed distance, the support function, and the volume in local coordinates.

    Args:
        dim: Dimension d of space, 2 or 3.
        pose: Rotation, translation, and scale applied to the shape.
        arguments: Constructor arguments without the pose, for `config` and `provenance`.

    Raises:
        InputError: If the dimension is not 2 or 3, or the pose is invalid.
    """

    def __init__(self, dim: int, pose: Pose, arguments: dict[str, Any]) -> None:
        if dim not in (2, 3):
            raise InputError(f"`center` must have 2 or 3 coordinates, got {dim}. Try `center=[0,0,0]`.")
        super().__init__(dim, Similarity.read(pose, dim))
        self._arguments = arguments

    @abstractmethod
    def support(self, u: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Evaluate the support function, max ⟨u, p⟩ over points p of the shape, for unit directions u."""

    @abstractmethod
    def local_volume(self) -> float:
        """Compute the volume in local coordinates (area in 2D)."""

    def config(self) -> dict[str, Any]:
        """Return class, arguments, and pose; there is no further state."""
        return {
            "_target_": f"nsm.shapes.{type(self).__name__}",
            **self._arguments,
            "pose": self.similarity.to_config(),
        }

    def local_box(self) -> Float[Tensor, "2 d"]:
        """Compute the bounding box in local coordinates with a margin."""
        box = _support_box(self.support, torch.eye(self.dim, dtype=torch.float64))
        margin = _MARGIN * float((box[1] - box[0]).max())
        return torch.stack([box[0] - margin, box[1] + margin]).to(torch.get_default_dtype())

    def exact_bounds(self) -> Float[Tensor, "2 d"]:
        """Compute the bounding box from the support function."""
        box = _support_box(self.support, self.similarity.rotation)
        return self.similarity.scale * box + self.similarity.translation

    def volume(self) -> float:
        """Compute the volume in closed form, s^d times that in local coordinates."""
        return self.similarity.scale**self.dim * self.local_volume()

    def provenance(self) -> dict[str, Any]:
        """Return the kind of shape, its arguments, and its similarity."""
        return {
            "kind": type(self).__name__.lower(),
            "arguments": self._arguments,
            "similarity": self.similarity.to_config(),
        }


def box_distance(q: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """Compute the distance to a box from q = |p| − size/2: ‖max(q, 0)‖ + min(max_i q_i, 0)."""
    return q.clamp(min=0).norm(dim=1) + q.amax(1).clamp(max=0)


def coordinates(values: Sequence[float]) -> list[float]:
    """Convert the coordinates of a point to floats."""
    return [float(v) for v in values]


def require_3d(center: Sequence[float]) -> None:
    """Validate the center of a shape that exists in 3D only.

    Raises:
        InputError: If it does not have three coordinates.
    """
    if len(center) != 3:
        raise InputError(f"`center` must have 3 coordinates for this shape, got {len(center)}. Try `center=[0,0,0]`.")


def _support_box(support: Callable[[Tensor], Tensor], rotation: Float[Tensor, "d d"]) -> Float[Tensor, "2 d"]:
    """Compute the bounding box of the rotated shape from its support in the directions Rᵀ(±e_i)."""
    return torch.stack([-support(-rotation), support(rotation)])
