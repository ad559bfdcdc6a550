"""Distances between meshes, and points spread over them."""

from __future__ import annotations

from typing import NamedTuple

import igl
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from nsm.geometry.topology import simplex_normals
from nsm.types import SimplexMesh, SurfaceSamples

#: Pairs of point and segment looked at in one go in 2D.
_PAIRS = 1 << 22


class Closest(NamedTuple):
    """For n points: distance to a mesh (n,), the closest point of it (n, d), and the simplex that holds it (n,)."""

    distances: Float[Tensor, " n"]
    points: Float[Tensor, "n d"]
    simplices: Int[Tensor, " n"]


class DistanceSummary(NamedTuple):
    """Mean, 99th percentile and greatest of many distances."""

    mean: float
    percentile_99: float
    maximum: float

    @classmethod
    def of(cls, distances: Float[Tensor, " n"]) -> DistanceSummary:
        """Summarise distances (n,)."""
        values = distances.detach().cpu().double().numpy()
        return cls(float(values.mean()), float(np.percentile(values, 99)), float(values.max()))


def closest_points(points: Float[Tensor, "n d"], mesh: SimplexMesh) -> Closest:
    """Closest point of a mesh to each of n points, exactly.

    Raises:
        ValueError: if the mesh has no simplices.
    """
    if not len(mesh.simplices):
        raise ValueError("the distance to a mesh without simplices is not defined: extract a surface that exists")
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


def sample_mesh(mesh: SimplexMesh, count: int, generator: torch.Generator | None = None) -> SurfaceSamples:
    """Points spread evenly over a mesh (count, d), and the normals of the simplices they lie on.

    Raises:
        ValueError: if the mesh has no simplices, or none of positive measure.
    """
    normals = simplex_normals(mesh)
    size = normals.norm(dim=1)
    if not bool((size > 0).any()):
        raise ValueError("a mesh without area has no points to draw: extract a surface that exists")
    chosen = torch.searchsorted(
        size.double().cumsum(0),
        torch.rand(count, generator=generator, dtype=torch.double, device=size.device) * size.double().sum(),
    ).clamp(max=len(size) - 1)
    # exponential spacings, normalised, are uniform on a simplex
    spacing = torch.rand(count, mesh.simplices.shape[1], 1, generator=generator, dtype=size.dtype, device=size.device)
    weights = -torch.log1p(-spacing)
    corners = mesh.vertices[mesh.simplices[chosen]]
    points = (corners * weights).sum(1) / weights.sum(1)
    return SurfaceSamples(points, normals[chosen] / size[chosen, None])


def _closest_on_segments(points: Tensor, mesh: SimplexMesh) -> Closest:
    start, end = mesh.vertices[mesh.simplices].to(points).unbind(1)
    along = end - start
    length = along.square().sum(1).clamp(min=torch.finfo(points.dtype).tiny)
    parts = []
    for chunk in points.split(max(1, _PAIRS // len(start))):
        share = (((chunk[:, None] - start) * along).sum(2) / length).clamp(0, 1)
        feet = start + share[..., None] * along
        squared, nearest = (chunk[:, None] - feet).square().sum(2).min(1)
        parts.append((squared.sqrt(), feet[torch.arange(len(chunk), device=feet.device), nearest], nearest))
    return Closest(*(torch.cat(part) for part in zip(*parts, strict=True)))
