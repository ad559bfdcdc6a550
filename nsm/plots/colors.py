"""Colors of points on a surface: by position, by origin at t = 0, or by a residual there."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import matplotlib
import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.cli.settings import choice, positive
from nsm.geometry.advection import RungeKutta, advect
from nsm.geometry.meshing import extract_surface
from nsm.io.palette import CLAY, srgb_from_linear
from nsm.metrics.residuals import eikonal_residual, level_set_residual
from nsm.morphs.advected import velocity_of
from nsm.types import Morph

#: Computes colors (n, 3), sRGB in 0..1, of points (n, d) of a morph's surface at a time.
ColorFunction = Callable[[Morph, Tensor, float], Tensor]

#: Perceptually uniform colormap of matplotlib whose lightness increases, so that it survives printing in gray.
_COLORMAP = "viridis"
#: Lightness in OKLab of the lowest and highest points, and chroma at the rim. All these colors lie within sRGB, so that
#: none is clipped and neighboring points differ evenly.
_LIGHTNESS, _CHROMA = (0.6, 0.79), 0.103
#: From OKLab to cube roots of the responses of the eye's cones, and from the responses to linear RGB:
#: https://bottosson.github.io/posts/oklab/
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
#: Cells along the box for the surface whose bounding box the colors span.
_BOUNDS_RESOLUTION = 32
#: Steps per unit of time: colors tolerate an error of a hundredth of the shape.
_METHOD = RungeKutta(6)
#: Points that are advected to find colors, and neighbors among them from which any other point is interpolated.
_SAMPLES, _NEIGHBORS = 6000, 4
#: Squared distance below which a point takes the color of its nearest sample.
_AT_A_SAMPLE = 1e-12
#: Residuals (n,) at points of a surface, each with the value at which the colormap ends by default.
RESIDUALS = {"level_set": (level_set_residual, 0.05), "eikonal": (eikonal_residual, 0.2)}


def colormap(values: Float[Tensor, " n"]) -> Float[Tensor, "n 3"]:
    """Map values in 0..1 to colors, sRGB in 0..1, on a perceptually uniform map; values outside are clamped."""
    colors = matplotlib.colormaps[_COLORMAP](values.detach().cpu().double().clamp(0, 1).numpy())
    return torch.as_tensor(colors[:, :3]).to(values)


def clay_colors(morph: Morph, points: Float[Tensor, "n d"], time: float) -> Float[Tensor, "n 3"]:
    """Give all points the color of clay."""
    return points.new_tensor(CLAY).expand(len(points), 3)


def position_colors(points: Float[Tensor, "n d"], bounds: Float[Tensor, "2 d"]) -> Float[Tensor, "n 3"]:
    """Compute smooth colors that distinguish parts of a shape by their position.

    Lightness increases upwards. The hue varies around the vertical axis: blue on the left, red in front, yellow on the
    right, green behind (axes a and b of OKLab). In 2D the hue shows both axes.

    Args:
        points: Points, clamped to ``bounds``.
        bounds: Lowest and highest corner of the box that the colors span.

    Returns:
        Colors, sRGB in 0..1.

    References:
        Ottosson, A perceptual color space for image processing, 2020, https://bottosson.github.io/posts/oklab/

    >>> position_colors(torch.zeros(1, 3), torch.tensor([[-1.0] * 3, [1.0] * 3]))
    tensor([[0.6145, 0.6145, 0.6145]])
    """
    low, high = bounds.to(points)
    place = (2 * (points - low) / (high - low).clamp(min=torch.finfo(points.dtype).tiny) - 1).clamp(-1, 1)
    across, up = place[:, 0], place[:, 1]
    depth = place[:, 2] if points.shape[1] == 3 else up
    # maps the square of the two axes to a disk, whose rim has constant chroma
    red, yellow = depth * (1 - across**2 / 2).sqrt(), across * (1 - depth**2 / 2).sqrt()
    darkest, lightest = _LIGHTNESS
    lightness = darkest + (lightest - darkest) * (up + 1) / 2
    lab = torch.stack([lightness, _CHROMA * red, _CHROMA * yellow], 1)
    linear = (lab @ lab.new_tensor(_LAB_TO_CONES).T) ** 3 @ lab.new_tensor(_CONES_TO_RGB).T
    return srgb_from_linear(linear.clamp(0, 1)).clamp(0, 1)


def current_position_colors(morph: Morph, points: Float[Tensor, "n d"], time: float) -> Float[Tensor, "n 3"]:
    """Color points by their position within the bounding box of the surface at t = 0."""
    return position_colors(points, surface_bounds(morph, 0.0))


def advected_colors(morph: Morph, points: Float[Tensor, "n d"], time: float) -> Float[Tensor, "n 3"]:
    """Color points of the surface at ``time`` by their position at t = 0, found by advecting them backwards along V.

    Colors vary slowly, so only some thousands of points are advected; the others are interpolated from the nearest.

    Raises:
        InputError: If the morph has no velocity.
    """
    bounds = surface_bounds(morph, 0.0)
    velocity = velocity_of(morph)

    def of(some: Tensor) -> Tensor:
        return position_colors(advect(velocity, some, [time, 0.0], _METHOD)[-1], bounds)

    if len(points) <= _SAMPLES:
        return of(points)
    chosen = torch.linspace(0, len(points) - 1, _SAMPLES, device=points.device).long()
    known = of(points[chosen]).cpu().double().numpy()
    places = points.cpu().double().numpy()
    distance, nearest = cKDTree(places[chosen.cpu().numpy()]).query(places, k=_NEIGHBORS)
    weight = 1 / (distance**2 + _AT_A_SAMPLE)
    mixed = np.einsum("nk,nkc->nc", weight, known[nearest]) / weight.sum(1, keepdims=True)
    return torch.as_tensor(mixed).to(points)


@torch.no_grad()
def residual_colors(
    morph: Morph, points: Float[Tensor, "n d"], time: float, what: str = "level_set", scale: float | None = None
) -> Float[Tensor, "n 3"]:
    """Color points by the absolute value of a residual there.

    Args:
        morph: The morph.
        points: Points of its surface at ``time``.
        time: Time from 0 to 1.
        what: Key of `RESIDUALS`.
        scale: Residual at which the colormap ends; by default the one that `RESIDUALS` gives.

    Returns:
        Colors, sRGB in 0..1.

    Raises:
        InputError: If the residual is unknown, the scale is not positive, or the morph lacks the velocity it needs.
    """
    residual, usual = RESIDUALS[choice("what", what, RESIDUALS)]
    scale = positive("scale", usual if scale is None else scale, usual)
    values = residual(morph, points, time)
    if values is None:
        raise InputError(
            f"The residual {what} needs a morph with a velocity, got one without. Try `color=eikonal`, or a morph "
            "trained with `method=adadiv`."
        )
    return colormap(values.abs() / scale)


#: Values of the setting ``color``.
COLORS: dict[str, ColorFunction] = {
    "clay": clay_colors,
    "position": current_position_colors,
    "advected": advected_colors,
    **{name: partial(residual_colors, what=name) for name in RESIDUALS},
}
#: Those that only morphs with a velocity can show.
NEED_VELOCITY = {"advected", "level_set"}


def color_function(name: str) -> ColorFunction:
    """Look up a value of the setting ``color``.

    Raises:
        InputError: If there is none of that name.
    """
    return COLORS[choice("color", name, COLORS)]


def surface_bounds(morph: Morph, time: float) -> Float[Tensor, "2 d"]:
    """Find the bounding box of the surface at a time on a coarse grid; the box of the morph if there is no surface."""
    vertices = extract_surface(partial(morph, t=time), morph.bounds, _BOUNDS_RESOLUTION).vertices
    return torch.stack([vertices.amin(0), vertices.amax(0)]) if len(vertices) else morph.bounds
