"""The map from the coordinates of a file to the box."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.shapes.similarity import Pose, Similarity


class FilePlacement:
    """The placement of a shape from a file: a rotation to upright, a fit to a given size, and a pose, in this order.

    Args:
        fit: Half the longest side of the bounding box after centering and scaling; None keeps the coordinates of the
            file, for example for two scans in common coordinates.
        pose: Rotation, translation, and scale applied after fitting.
        up: Direction in the coordinates of the file that becomes +y, before all else; None for +y.
        dim: Dimension of the shape, 2 or 3.

    Raises:
        InputError: If one of them is invalid.
    """

    def __init__(self, fit: float | None, pose: Pose, up: Sequence[float] | None, dim: int = 3) -> None:
        if fit is not None and not 0 < float(fit) <= 1:
            raise InputError(
                f"`fit` must be in (0, 1], or null to keep the coordinates of the file, got {fit}. Try `fit=0.8`."
            )
        self.fit = None if fit is None else float(fit)
        self.pose, self.upright = Similarity.read(pose, dim), Similarity.upright(up, dim)

    def of_centered(self, points: Float[Tensor, "v d"], center: Float[Tensor, " d"]) -> Similarity:
        """Compute the similarity to the box from coordinates relative to the center of the shape.

        Args:
            points: Points of the shape relative to its center, shape (v, d).
            center: Center in the coordinates of the file, shape (d,).
        """
        if self.fit is None:
            return self.pose.after(self.upright).after(Similarity.shift(center))
        upright = self.upright.apply(points)
        fitting = Similarity.centering(torch.stack([upright.amin(0), upright.amax(0)]), self.fit)
        return self.pose.after(fitting).after(self.upright)


def centered(points: Float[Tensor, "v d"]) -> tuple[Float[Tensor, "v d"], Float[Tensor, " d"]]:
    """Subtract the center of the bounding box from points without loss of precision, and return both."""
    center = (points.amin(0) + points.amax(0)) / 2
    return points - center, center
