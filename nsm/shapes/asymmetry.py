"""Deviation of a shape from its mirror image."""

from __future__ import annotations

import torch

from nsm.geometry.reflection import Reflection
from nsm.shapes.base import FieldShape

#: Points on the surface whose mirror images are compared with it.
_POINTS = 2000


@torch.no_grad()
def asymmetry(shape: FieldShape, reflection: Reflection) -> float:
    """Mean distance of mirror images of surface points from the surface, a length in the box.

    Example:
        >>> from nsm.shapes import Ball
        >>> ball = Ball(0.5, [0.1, 0.0, 0.0])
        >>> asymmetry(ball, Reflection.at([0, 1, 0], 0.0)) < 1e-6, asymmetry(ball, Reflection.at([1, 0, 0], 0.0)) > 0.05
        (True, True)
    """
    points = shape.surface_samples(_POINTS, torch.Generator().manual_seed(0)).points
    return float(shape.true_distance(reflection.points(points)).abs().mean())
