"""The way of a shape from its file to the box."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.shapes.primitive import Pose
from nsm.shapes.similarity import Similarity


class FilePlacement:
    """What people say of the place of a shape in space: turned upright, fitted, then posed.

    Args:
        fit: half of the longest side of the shape's bounding box after it was centered and scaled; None keeps the
            coordinates of the file, for two scans in one common frame.
        pose: rotation, translation and scale given to the shape after that.
        up: the direction in the coordinates of the file that becomes +y, before all else; None if it is +y already.
        dim: dimension of the shape, 2 or 3.

    Raises:
        InputError: if one of them cannot be read.
    """

    def __init__(self, fit: float | None, pose: Pose, up: Sequence[float] | None, dim: int = 3) -> None:
        if fit is not None and not 0 < float(fit) <= 1:
            raise InputError(f"fit is {fit}: give a number in (0, 1], or null to keep the coordinates of the file.")
        self.fit = None if fit is None else float(fit)
        self.pose, self.upright = Similarity.read(pose, dim), Similarity.upright(up, dim)

    def of_centered(self, points: Float[Tensor, "v d"], center: Float[Tensor, " d"]) -> Similarity:
        """The similarity to the box from coordinates relative to the center of the shape.

        Args:
            points: the shape, relative to its center.
            center: in the coordinates of the file.
        """
        if self.fit is None:
            return self.pose.after(self.upright).after(Similarity.shift(center))
        turned = self.upright.apply(points)
        fitting = Similarity.centering(torch.stack([turned.amin(0), turned.amax(0)]), self.fit)
        return self.pose.after(fitting).after(self.upright)


def centered(points: Float[Tensor, "v d"]) -> tuple[Float[Tensor, "v d"], Float[Tensor, " d"]]:
    """Points relative to the center of their bounding box, which loses nothing however far it is away; the center."""
    center = (points.amin(0) + points.amax(0)) / 2
    return points - center, center
