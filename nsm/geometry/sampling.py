"""Random points on meshes."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nsm.geometry.topology import simplex_areas
from nsm.types import SimplexMesh


class MeshSamples(NamedTuple):
    """Points on a mesh.

    Attributes:
        points: Positions, shape (n, d).
        simplices: Index of the simplex of each point, shape (n,).
    """

    points: Float[Tensor, "n d"]
    simplices: Int[Tensor, " n"]


def sample_mesh(mesh: SimplexMesh, count: int, generator: torch.Generator) -> MeshSamples:
    """Sample points uniformly by area on a mesh (by length in 2D).

    Args:
        mesh: Triangles in 3D or segments in 2D.
        count: Number of points n.
        generator: Source of random numbers.

    Raises:
        ValueError: If the mesh has no simplices of positive area.
    """
    corners = mesh.vertices[mesh.simplices]
    cumulative = simplex_areas(corners).double().cumsum(0)
    if not len(cumulative) or not cumulative[-1] > 0:
        raise ValueError("`mesh` must have a positive area, got 0. Try a level that the field takes.")
    device, size = corners.device, (count, corners.shape[1])
    draws = torch.rand(count, generator=generator, dtype=torch.float64, device=device) * cumulative[-1]
    chosen = torch.searchsorted(cumulative, draws).clamp_(max=len(cumulative) - 1)
    # normalized exponential variables are uniform barycentric coordinates
    draws = torch.rand(size, generator=generator, dtype=corners.dtype, device=device)
    weights = -draws.clamp_(min=1e-12).log()
    weights /= weights.sum(1, keepdim=True)
    return MeshSamples((weights[:, :, None] * corners[chosen]).sum(1), chosen)
