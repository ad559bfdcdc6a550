"""Points drawn on meshes and around surfaces."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nsm.types import SimplexMesh

#: Standard deviations of the offsets from the surface, half of the points each, where a shape spans about [-1, 1]:
#: variances 0.0025 and 0.00025 as DeepSDF takes them (Park et al., CVPR 2019, section 5.1).
NEAR_SIGMAS = (0.05, 0.0158)


def sample_mesh_surface(
    mesh: SimplexMesh, count: int, generator: torch.Generator
) -> tuple[Float[Tensor, "n d"], Int[Tensor, " n"]]:
    """Draw points uniformly by area (length in 2D).

    Returns:
        points (n, d), and the simplex (n,) that each lies in.
    """
    corners = mesh.vertices[mesh.simplices]
    areas = simplex_areas(corners)
    cumulated = areas.double().cumsum(0)
    draws = torch.rand(count, generator=generator, dtype=torch.float64) * cumulated[-1]
    chosen = torch.searchsorted(cumulated, draws).clamp_(max=len(areas) - 1)
    # exponential variates divided by their sum are uniform on the simplex
    weights = -torch.rand(count, corners.shape[1], generator=generator, dtype=corners.dtype).clamp_(min=1e-12).log()
    weights /= weights.sum(1, keepdim=True)
    return (weights[:, :, None] * corners[chosen]).sum(1), chosen


def simplex_areas(corners: Float[Tensor, "m k d"]) -> Float[Tensor, " m"]:
    """Areas (lengths in 2D) of simplices given by their corners (m, d, d)."""
    edges = corners[:, 1:] - corners[:, :1]
    gram = edges @ edges.transpose(1, 2)
    return gram.det().clamp_(min=0).sqrt() / (1 if edges.shape[1] == 1 else 2)


def simplex_normals(corners: Float[Tensor, "m k d"]) -> Float[Tensor, "m d"]:
    """Unit normals (m, d) of simplices given by their corners: right of a segment, right-handed for a triangle."""
    edges = corners[:, 1:] - corners[:, :1]
    if corners.shape[2] == 2:
        normals = torch.stack([edges[:, 0, 1], -edges[:, 0, 0]], 1)
    else:
        normals = torch.linalg.cross(edges[:, 0], edges[:, 1])
    return torch.nn.functional.normalize(normals, dim=1)


def ambient_points(
    on_surface: Float[Tensor, "k d"], count: int, generator: torch.Generator, bounds: Float[Tensor, "2 d"]
) -> Float[Tensor, "n d"]:
    """Points of which half are uniform in ``bounds`` and half near the surface, at Gaussian offsets (`NEAR_SIGMAS`).

    Args:
        on_surface: at least ``count // 2`` points of the surface.
        count: how many points to return.
    """
    near = count // 2
    base = on_surface[:near]
    low, high = bounds.to(base)
    uniform = low + (high - low) * torch.rand(count - near, len(low), generator=generator, dtype=base.dtype)
    sigma = base.new_full((near, 1), NEAR_SIGMAS[0])
    sigma[near // 2 :] = NEAR_SIGMAS[1]
    return torch.cat([uniform, base + sigma * torch.randn(base.shape, generator=generator, dtype=base.dtype)])
