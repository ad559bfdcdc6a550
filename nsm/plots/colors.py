"""Colors of points on a surface: by where they are, by where they came from, by an error there."""

from __future__ import annotations

from functools import partial

import matplotlib
import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.advection import RungeKutta, advect
from nsm.geometry.meshing import extract_surface
from nsm.metrics.residuals import eikonal_residual, level_set_residual
from nsm.morphs.advected import velocity_of
from nsm.types import Morph

#: A map of matplotlib whose steps look equally large and whose lightness grows: also right in gray.
_PALETTE = "viridis"
#: Lightness in OKLab of the lowest and of the highest points, and chroma on the rim: all of it lies within sRGB, so
#: that no color is clipped and neighbors keep apart evenly.
_LIGHTNESS, _CHROMA = (0.6, 0.79), 0.103
#: From OKLab to cube roots of the responses of the eye's cones, and from the responses to linear RGB (Ottosson, 2020).
_LAB_TO_CONES = (
    (1.0, 0.3963377774, 0.2158037573),
    (1.0, -0.1055613458, -0.0638541728),
    (1.0, -0.0894841775, -1.2914855480),
)
_CONES_TO_RGB = (
    (4.0767416621, -3.3077115913, 0.2309699292),
    (-1.2684380046, 2.6097574011, -0.3413193965),
    (-0.0041960863, -0.7034186147, 1.7076147010),
)
#: Cells along the box for the surface whose bounds the colors span.
_BOUNDS_RESOLUTION = 32
#: Steps in a unit of time: colors need no more than a hundredth of the shape.
_METHOD = RungeKutta(6)
#: Residuals (n,) at points of a surface, each with the size that has the last color unless told otherwise.
RESIDUALS = {"level_set": (level_set_residual, 0.05), "eikonal": (eikonal_residual, 0.2)}


def palette(values: Float[Tensor, " n"]) -> Float[Tensor, "n 3"]:
    """Colors (n, 3), sRGB in 0..1, of values (n,) in 0..1 on a perceptually uniform map; others are clamped."""
    colors = matplotlib.colormaps[_PALETTE](values.detach().cpu().double().clamp(0, 1).numpy())
    return torch.as_tensor(colors[:, :3]).to(values)


def position_colors(points: Float[Tensor, "n d"], bounds: Float[Tensor, "2 d"]) -> Float[Tensor, "n 3"]:
    """Smooth colors (n, 3), sRGB in 0..1, that tell parts of a shape apart by where they are.

    Up is light and down is dark; around the upright axis the hue turns: blue at the left, red in front, yellow at the
    right, green behind (axes a and b of OKLab: Ottosson, A perceptual color space for image processing, 2020). In 2D
    the hue shows both axes.

    Args:
        points: (n, d), clamped to ``bounds``.
        bounds: corners (2, d) of the box that the colors span, lowest first.
    """
    low, high = bounds.to(points)
    place = (2 * (points - low) / (high - low).clamp(min=torch.finfo(points.dtype).tiny) - 1).clamp(-1, 1)
    across, up = place[:, 0], place[:, 1]
    depth = place[:, 2] if points.shape[1] == 3 else up
    # the square of the two axes on a disk, whose rim has one chroma
    red, yellow = depth * (1 - across**2 / 2).sqrt(), across * (1 - depth**2 / 2).sqrt()
    darkest, lightest = _LIGHTNESS
    lightness = darkest + (lightest - darkest) * (up + 1) / 2
    return _srgb(torch.stack([lightness, _CHROMA * red, _CHROMA * yellow], 1))


def carried_colors(morph: Morph, points: Float[Tensor, "n d"], time: float) -> Float[Tensor, "n 3"]:
    """Colors (n, 3) of points of the surface at ``time``, by where they come from on the surface at t = 0.

    Raises:
        InputError: if the morph has no velocity.
    """
    velocity = velocity_of(morph)
    origin = advect(velocity, points, [time, 0.0], _METHOD)[-1]
    return position_colors(origin, surface_bounds(morph, 0.0))


def surface_bounds(morph: Morph, time: float) -> Float[Tensor, "2 d"]:
    """Corners (2, d) of the box around the surface at a time, as a coarse grid sees it; of the morph without one."""
    vertices = extract_surface(partial(morph, t=time), morph.bounds, _BOUNDS_RESOLUTION).vertices
    return torch.stack([vertices.amin(0), vertices.amax(0)]) if len(vertices) else morph.bounds


@torch.no_grad()
def residual_colors(
    morph: Morph, points: Float[Tensor, "n d"], time: float, what: str = "level_set", scale: float | None = None
) -> Float[Tensor, "n 3"]:
    """Colors (n, 3) of points (n, d) by the size of a residual there.

    Args:
        morph: the morph.
        points: of the surface at ``time``.
        time: from 0 to 1.
        what: a key of `RESIDUALS`.
        scale: the residual that has the last color of the palette; that of `RESIDUALS` by default.

    Raises:
        InputError: if there is no such residual, the scale is not positive, or the morph has no velocity to measure.
    """
    if what not in RESIDUALS:
        raise InputError(f"{what} is no residual that can be shown: give one of {', '.join(RESIDUALS)}")
    residual, usual = RESIDUALS[what]
    scale = usual if scale is None else scale
    if not scale > 0:
        raise InputError(f"scale={scale} has no last color: give the residual that shall have it, such as {usual}")
    values = residual(morph, points, time)
    if values is None:
        raise InputError(
            f"this morph has no velocity, so it has no {what} residual to show: ask for eikonal, or give a morph that "
            "was trained with a velocity"
        )
    return palette(values.abs() / scale)


def _srgb(lab: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """OKLab (n, 3) to sRGB (n, 3), clamped to 0..1."""
    linear = ((lab @ lab.new_tensor(_LAB_TO_CONES).T) ** 3 @ lab.new_tensor(_CONES_TO_RGB).T).clamp(0, 1)
    return torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055).clamp(0, 1)
