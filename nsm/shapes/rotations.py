"""Sets of rotations, and distances between them."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from kornia.geometry.conversions import quaternion_to_rotation_matrix
from torch import Tensor

#: Rotations that cover all of them, by dimension: every 10 degrees in 2D, about every 30 in 3D.
COVERING = {2: 36, 3: 400}
#: ψ⁴ = ψ + 4, with which √2 makes the best spirals of quaternions.
_PSI = 1.533751168755204288118041


def covering_rotations(dim: int) -> Float[Tensor, "k d d"]:
    """Rotations spread evenly over all of them: equal angles in 2D, a super-Fibonacci spiral of quaternions in 3D.

    Args:
        dim: Dimension d of space, 2 or 3.

    Returns:
        Rotation matrices in double precision, shape (k, d, d).

    References:
        Alexa, Super-Fibonacci spirals: fast, low-discrepancy sampling of SO(3), CVPR 2022.
        https://doi.org/10.1109/CVPR52688.2022.00811
    """
    count = COVERING[dim]
    place = torch.arange(count, dtype=torch.float64) + 0.5
    if dim == 2:
        angle = 2 * math.pi * place / count
        rows = [torch.stack([angle.cos(), -angle.sin()], 1), torch.stack([angle.sin(), angle.cos()], 1)]
        return torch.stack(rows, 1)
    share = place / count
    first, second = 2 * math.pi * place / math.sqrt(2), 2 * math.pi * place / _PSI
    inner, outer = share.sqrt(), (1 - share).sqrt()
    parts = [outer * second.cos(), inner * first.sin(), inner * first.cos(), outer * second.sin()]
    return quaternion_to_rotation_matrix(torch.stack(parts, 1))


def rotation_generators(dim: int) -> Float[Tensor, "g d d"]:
    """Basis of the skew-symmetric matrices, whose exponentials are the rotations.

    Args:
        dim: Dimension d of space.

    Returns:
        Matrices e_j e_iᵀ − e_i e_jᵀ for i < j in double precision, shape (d (d − 1) / 2, d, d).
    """
    pairs = [(i, j) for i in range(dim) for j in range(i + 1, dim)]
    generators = torch.zeros(len(pairs), dim, dim, dtype=torch.float64)
    for generator, (i, j) in zip(generators, pairs, strict=True):
        generator[j, i], generator[i, j] = 1.0, -1.0
    return generators


def rotation_angles(rotations: Float[Tensor, "k d d"]) -> Float[Tensor, " k"]:
    """Angles of rotations in degrees, from 0 to 180, shape (k,).

    ‖R − I‖ is 2√2 sin(θ/2) in 2D and in 3D; unlike the trace, it also resolves small angles.
    """
    identity = torch.eye(rotations.shape[-1], dtype=rotations.dtype)
    chord = (rotations - identity).flatten(1).norm(dim=1) / math.sqrt(8)
    return torch.rad2deg(2 * chord.clamp(max=1).asin())
