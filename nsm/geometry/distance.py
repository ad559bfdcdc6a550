"""Exact distances to a mesh, and points sampled on it."""

from __future__ import annotations

from typing import NamedTuple

import igl
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from nsm.types import SimplexMesh

#: Maximum number of point-segment combinations evaluated at once in 2D.
_COMBINATIONS = 1 << 22


class Closest(NamedTuple):
    """The closest points of a mesh to n points.

    Attributes:
        distances: Distances to the mesh, shape (n,).
        points: Closest points of the mesh, shape (n, d).
        simplices: Indices of the simplices that contain the closest points, shape (n,).
    """

    distances: Float[Tensor, " n"]
    points: Float[Tensor, "n d"]
    simplices: Int[Tensor, " n"]


class DistanceSummary(NamedTuple):
    """Mean, 99th percentile, and maximum of distances."""

    mean: float
    percentile_99: float
    maximum: float

    @classmethod
    def of(cls, distances: Float[Tensor, " n"]) -> DistanceSummary:
        """Summarize distances, shape (n,)."""
        values = distances.detach().cpu().double().numpy()
        return cls(float(values.mean()), float(np.percentile(values, 99)), float(values.max()))


def closest_points(points: Float[Tensor, "n d"], mesh: SimplexMesh) -> Closest:
    """Find the closest point of a mesh to each of n points, without approximation.

    Args:
        points: Query points, shape (n, d).
        mesh: Triangles in 3D or segments in 2D.

    Raises:
        ValueError: If the mesh has no simplices.

    Example:
        >>> import torch
        >>> from nsm.geometry.distance import closest_points
        >>> from nsm.types import SimplexMesh
        >>> segment = SimplexMesh(torch.tensor([[0.0, 0.0], [1.0, 0.0]]), torch.tensor([[0, 1]]))
        >>> closest_points(torch.tensor([[0.5, 2.0]]), segment).distances
        tensor([2.])
    """
    if not len(mesh.simplices):
        raise ValueError("`mesh` must have at least one simplex, got none. Try a level that the field takes.")
    if points.shape[1] == 2:
        return _closest_on_segments(points, mesh)
    squared, simplices, nearest = igl.point_mesh_squared_distance(
        *(np.ascontiguousarray(a.detach().cpu().double().numpy()) for a in (points, mesh.vertices)),
        np.ascontiguousarray(mesh.simplices.cpu().numpy()),
    )
    return Closest(
        torch.as_tensor(squared).clamp(min=0).sqrt().to(points),
        torch.as_tensor(nearest).to(points),
        torch.as_tensor(simplices, dtype=torch.long, device=points.device),
    )


def _closest_on_segments(points: Tensor, mesh: SimplexMesh) -> Closest:
    start, end = mesh.vertices[mesh.simplices].to(points).unbind(1)
    along = end - start
    length = along.square().sum(1).clamp(min=torch.finfo(points.dtype).tiny)
    parts = []
    for chunk in points.split(max(1, _COMBINATIONS // len(start))):
        share = (((chunk[:, None] - start) * along).sum(2) / length).clamp(0, 1)
        feet = start + share[..., None] * along
        squared, nearest = (chunk[:, None] - feet).square().sum(2).min(1)
        parts.append((squared.sqrt(), feet[torch.arange(len(chunk), device=feet.device), nearest], nearest))
    return Closest(*(torch.cat(part) for part in zip(*parts, strict=True)))
