"""Reflections at planes, or at lines in 2D."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from nsm.cli.settings import invalid, number, numbers


@dataclass(frozen=True)
class Reflection:
    """The reflection R x + 2 o n at the plane ⟨n, x⟩ = o, with R = 1 − 2 n nᵀ.

    Attributes:
        normal: Unit normal n, d numbers.
        offset: Distance o of the plane from the origin along n.

    Example:
        >>> import torch
        >>> Reflection.at([1, 0], 0.5).points(torch.tensor([[2.0, 3.0]]))
        tensor([[-1.,  3.]])
    """

    normal: tuple[float, ...]
    offset: float = 0.0

    @staticmethod
    def at(normal: Sequence[float], offset: float, dim: int | None = None) -> Reflection:
        """Make the reflection of a plane.

        Args:
            normal: Direction of the normal, of any length. In 2D, its third number is left out.
            offset: Distance of the plane from the origin along the normal.
            dim: Dimension d; None for that of ``normal``.

        Raises:
            InputError: If ``normal`` is no direction in d dimensions, or ``offset`` is not a finite number.
        """
        given = [float(entry) for entry in numbers("symmetry.normal", list(normal))]
        kept = given[: len(given) if dim is None else dim]
        length = math.hypot(*kept)
        if len(given) not in (2, 3) or (dim is not None and len(kept) != dim) or not length:
            where = "2D or 3D" if dim is None else f"{dim}D"
            raise invalid("symmetry.normal", f"a direction in {where}", list(normal), "[1,0,0]")
        return Reflection(tuple(entry / length for entry in kept), number("symmetry.offset", offset, 0.0))

    @property
    def dim(self) -> int:
        """Dimension d of space."""
        return len(self.normal)

    def points(self, p: Float[Tensor, "n k"]) -> Float[Tensor, "n k"]:
        """Reflect points, shape (n, d), or points of space-time, shape (n, d + 1), whose last column stays."""
        normal = p.new_tensor(self._column(p))
        return p + 2 * (self.offset - p @ normal) * normal.T

    def vectors(self, v: Float[Tensor, "*n k"]) -> Float[Tensor, "*n k"]:
        """Apply R to vectors in the last dimension, of d components, or of d + 1, the last of which stays."""
        normal = v.new_tensor(self._column(v))
        return v - 2 * (v @ normal) * normal[:, 0]

    def _column(self, x: Tensor) -> list[list[float]]:
        """n as a column, with a zero for the component of time if there is one."""
        return [[entry] for entry in (*self.normal, 0.0)[: x.shape[-1]]]
