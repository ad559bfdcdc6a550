"""Random points around surfaces, and normals of simplices."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

#: Standard deviations of the offsets from the surface, each for half of the points, for a shape that spans about
#: [-1, 1]: variances 0.0025 and 0.00025 as in DeepSDF (Park et al., CVPR 2019, https://arxiv.org/abs/1901.05103).
NEAR_SIGMAS = (0.05, 0.0158)


def unit_normals(corners: Float[Tensor, "m k d"]) -> Float[Tensor, "m d"]:
    """Compute unit normals of simplices with corners of shape (m, d, d): to the right of a segment, or right-handed."""
    edges = corners[:, 1:] - corners[:, :1]
    if corners.shape[2] == 2:
        normals = torch.stack([edges[:, 0, 1], -edges[:, 0, 0]], 1)
    else:
        normals = torch.linalg.cross(edges[:, 0], edges[:, 1])
    return torch.nn.functional.normalize(normals, dim=1)


def ambient_points(
    on_surface: Float[Tensor, "k d"], count: int, generator: torch.Generator, bounds: Float[Tensor, "2 d"]
) -> Float[Tensor, "n d"]:
    """Sample points, half of them uniform in a box and half near a surface with Gaussian offsets (`NEAR_SIGMAS`).

    Args:
        on_surface: Points on the surface, shape (k, d) with k ≥ ``count // 2``.
        count: Number of points n.
        generator: Source of random numbers.
        bounds: Corners of the box, shape (2, d).
    """
    near = count // 2
    base = on_surface[:near]
    low, high = bounds.to(base)
    uniform = low + (high - low) * torch.rand(count - near, len(low), generator=generator, dtype=base.dtype)
    sigma = base.new_full((near, 1), NEAR_SIGMAS[0])
    sigma[near // 2 :] = NEAR_SIGMAS[1]
    return torch.cat([uniform, base + sigma * torch.randn(base.shape, generator=generator, dtype=base.dtype)])
