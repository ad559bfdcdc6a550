"""Colors shared by exported files, pictures, and the viewer."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

#: Color of a surface that shows nothing else, sRGB in 0..1: light, so that shadows stay visible on it.
CLAY = (0.640, 0.740, 0.890)
#: Inside of a 2D shape and its outline, sRGB in 0..1.
INSIDE, OUTLINE = (0.812, 0.882, 0.961), (0.090, 0.290, 0.522)


def linear_from_srgb(colors: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
    """Convert sRGB in 0..1 to linear RGB, the form in which glTF and USD store colors of vertices.

    c ↦ c / 12.92 for c ≤ 0.04045, and ((c + 0.055) / 1.055)^2.4 above.

    References:
        IEC 61966-2-1; https://www.w3.org/Graphics/Color/sRGB

    >>> linear_from_srgb(torch.tensor([0.0, 0.5, 1.0]))
    tensor([0.0000, 0.2140, 1.0000])
    """
    return torch.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)


def srgb_from_linear(colors: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
    """Convert linear RGB in 0..1 to sRGB, the inverse of `linear_from_srgb`.

    >>> srgb_from_linear(torch.tensor([0.0000, 0.2140, 1.0000]))
    tensor([0.0000, 0.5000, 1.0000])
    """
    return torch.where(colors <= 0.0031308, 12.92 * colors, 1.055 * colors ** (1 / 2.4) - 0.055)
