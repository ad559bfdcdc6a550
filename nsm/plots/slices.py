"""Slices through a morph that show the residuals of its two equations, with the surface as a contour."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patheffects import withStroke
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.cli.settings import choice, invalid
from nsm.geometry.grid import Lattice, evaluate
from nsm.metrics.residuals import eikonal_residual, level_set_residual
from nsm.types import Morph

#: Default times of the columns.
TIMES = (0.25, 0.5, 0.75)
#: Names of the axes of space.
AXES = "xyz"
#: Points evaluated at once, few since the Jacobian of a velocity takes much more memory than a value.
_CHUNK = 1 << 14
#: Color map: perceptually uniform, and light where a residual is small so that black lines stand out.
_COLORS = "magma_r"
#: Percentile of all residuals of a kind at which the color scale ends, since a few values are far larger.
_PERCENTILE = 99.0
#: Distance between the level sets that are drawn besides the surface, relative to the longest edge of the box.
_LEVELS = 0.05
#: Sizes in inches: width of a picture, of the names, and of the color bar, and height of the titles.
_PICTURE, _NAMES, _BAR, _TITLE = 1.7, 0.35, 0.75, 0.3

Residual = Callable[[Morph, Tensor, float], Tensor | None]
#: Residuals that are shown, by the label of their color bar.
RESIDUALS: dict[str, Residual] = {
    "Eikonal  | ‖∇f‖ − 1 |": eikonal_residual,
    "level set  | ∂f/∂t + ⟨∇f, V⟩ |": level_set_residual,
}


class SlicePlane(NamedTuple):
    """Plane of a slice through a morph in 3D; in 2D the whole box is shown.

    Attributes:
        axis: Axis perpendicular to the plane: x, y, or z.
        offset: Coordinate of the plane along this axis.
    """

    axis: str = "z"
    offset: float = 0.0


#: Default plane.
MIDDLE = SlicePlane()


class _Slice(NamedTuple):
    """Content of one picture.

    Attributes:
        values: Values of f, shape (rows, columns), the lowest row first.
        residual: Residual at the same points; None for a morph without velocity.
        extent: Left, right, bottom, and top edge.
    """

    values: np.ndarray
    residual: np.ndarray | None
    extent: tuple[float, float, float, float]


def plot_residual_slices(
    path: Path | str,
    morphs: Morph | Mapping[str, Morph],
    times: Sequence[float] = TIMES,
    plane: SlicePlane = MIDDLE,
    *,
    resolution: int = 200,
    dpi: int = 250,
) -> None:
    """Draw both residuals at some times, one row per residual and morph, with the surface as a strong line.

    Rows of one residual share a color scale, which ends at the 99th percentile. Thin lines are further level sets,
    whose distances vary where f is not a distance. A morph without velocity has no row for the level set residual.

    Args:
        path: Picture to write; its suffix chooses the format (.png, .pdf, .svg).
        morphs: One morph, or several of the same dimension by the name that is written beside their rows.
        times: Times of the columns.
        plane: Plane of the slices (3D).
        resolution: Pixels along the longest edge of the box.
        dpi: Pixels per inch of the picture; each slice is 1.7 inches wide.

    Raises:
        InputError: If the morphs differ in dimension, a time is not in [0, 1], or the plane does not intersect the box
            of a morph.
    """
    rows = morphs if isinstance(morphs, Mapping) else {"": morphs}
    require_slices(rows, times, plane)
    slices = {
        label: {
            name: [_slice(morph, time, plane, residual, resolution) for time in times] for name, morph in rows.items()
        }
        for label, residual in RESIDUALS.items()
    }
    # a morph without velocity has no row of level set residuals
    shown = {
        label: {name: row for name, row in parts.items() if row[0].residual is not None}
        for label, parts in slices.items()
    }
    shown = {label: parts for label, parts in shown.items() if parts}
    figure, grid = _figure([row for parts in shown.values() for row in parts.values()], bool(any(rows)), dpi)
    dim = next(iter(rows.values())).dim
    first = 0
    for label, parts in shown.items():
        block = grid[first : first + len(parts)]
        first += len(parts)
        scale = _scale(parts)
        for axes, (name, row) in zip(block, parts.items(), strict=True):
            images = [_draw(axis, piece, scale) for axis, piece in zip(axes, row, strict=True)]
            axes[0].set_ylabel(name, fontsize=8)
        bar = figure.colorbar(images[0], ax=block.ravel().tolist(), extend="max", aspect=14 * len(parts), pad=0.015)
        bar.set_label(label, fontsize=8)
        bar.ax.tick_params(labelsize=7)
    where = "" if dim == 2 else f",  {plane.axis} = {plane.offset:g}"
    for axis, time in zip(grid[0], times, strict=True):
        axis.set_title(f"t = {time:.3g}{where}", fontsize=8)
    with atomic_write(path) as temporary:
        figure.savefig(temporary, facecolor="white")


def require_slices(rows: Mapping[str, Morph], times: Sequence[float], plane: SlicePlane, prefix: str = "") -> None:
    """Check that slices can be drawn, before long work is done for them.

    Args:
        rows: Morphs by name.
        times: Times of the columns.
        plane: Plane of the slices (3D).
        prefix: Beginning of the names of the settings in messages, such as ``slices.``.

    Raises:
        InputError: As `plot_residual_slices` does.
    """
    dims = {morph.dim for morph in rows.values()}
    if len(dims) != 1:
        raise InputError(
            f"`checkpoint` must name morphs of one dimension for one picture of slices, got dimensions {sorted(dims)}. "
            "Try one picture for each dimension."
        )
    if not len(times) or not all(0 <= time <= 1 for time in times):
        raise invalid(f"{prefix}times", "a list of times from 0 to 1", list(times), "[0.25,0.5]")
    if dims == {2}:
        return
    choice(f"{prefix}axis", plane.axis, AXES)
    for morph in rows.values():
        low, high = morph.bounds[:, AXES.index(plane.axis)].tolist()
        if not low < plane.offset < high:
            inside = f"a coordinate inside the box of the morph, between {low:g} and {high:g}"
            raise invalid(f"{prefix}offset", inside, f"{plane.offset:g}", f"{(low + high) / 2:g}")


def _slice(morph: Morph, time: float, plane: SlicePlane, residual: Residual, resolution: int) -> _Slice:
    """Evaluate f and a residual at the pixels of a plane."""
    across = [axis for axis in range(morph.dim) if morph.dim == 2 or AXES[axis] != plane.axis]
    bounds = morph.bounds[:, across]
    lattice = Lattice.centers(bounds, resolution)
    ticks = [torch.arange(n, device=bounds.device) for n in lattice.shape]
    flat = lattice.points(torch.stack(torch.meshgrid(*ticks, indexing="xy"), -1)).view(-1, 2)
    points = _lifted(flat, across, morph.dim, plane.offset)
    parts = [residual(morph, chunk, time) for chunk in points.split(_CHUNK)]
    known = [part.abs().double().cpu().numpy() for part in parts if part is not None]
    shape = lattice.shape[::-1]
    values = evaluate(lambda x: morph(x, time), points).double().cpu().numpy().reshape(shape)
    (left, bottom), (right, top) = bounds.tolist()
    return _Slice(values, np.concatenate(known).reshape(shape) if known else None, (left, right, bottom, top))


def _lifted(flat: Float[Tensor, "n 2"], across: Sequence[int], dim: int, offset: float) -> Float[Tensor, "n d"]:
    points = flat.new_full((len(flat), dim), offset)
    points[:, list(across)] = flat
    return points


def _scale(parts: Mapping[str, Sequence[_Slice]]) -> float:
    """Residual at the end of the color scale."""
    values = [piece.residual for row in parts.values() for piece in row if piece.residual is not None]
    top = float(np.nanpercentile(np.concatenate([v.ravel() for v in values]), _PERCENTILE))
    # residuals of an exact morph are rounding errors, and must not fill the color scale
    return max(top, 1e-4) if math.isfinite(top) else 1.0


def _draw(axis: Axes, piece: _Slice, scale: float) -> AxesImage:
    residual = np.full_like(piece.values, np.nan) if piece.residual is None else piece.residual
    image = axis.imshow(
        residual, extent=piece.extent, origin="lower", cmap=_COLORS, vmin=0, vmax=scale, interpolation="bilinear"
    )
    left, right, bottom, top = piece.extent
    rows, columns = piece.values.shape
    x = left + (np.arange(columns) + 0.5) * (right - left) / columns
    y = bottom + (np.arange(rows) + 0.5) * (top - bottom) / rows
    step = _LEVELS * max(right - left, top - bottom)
    levels = step * np.arange(np.floor(piece.values.min() / step), np.ceil(piece.values.max() / step) + 1)
    axis.contour(x, y, piece.values, levels[levels != 0], colors="0.35", linewidths=0.25, linestyles="-", alpha=0.6)
    if piece.values.min() < 0 < piece.values.max():
        surface = axis.contour(x, y, piece.values, [0.0], colors="black", linewidths=1.1)
        surface.set(path_effects=[withStroke(linewidth=2.2, foreground="white")])
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set(color="0.6", linewidth=0.5)
    return image


def _figure(rows: Sequence[Sequence[_Slice]], named: bool, dpi: int) -> tuple[Figure, np.ndarray]:
    """Make a figure whose axes have the shapes of the slices."""
    heights = [_PICTURE * (p[0].extent[3] - p[0].extent[2]) / (p[0].extent[1] - p[0].extent[0]) for p in rows]
    columns = len(rows[0])
    size = (columns * _PICTURE + _BAR + (_NAMES if named else 0), sum(heights) + 0.05 * len(rows) + _TITLE)
    close = ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.02, wspace=0.0, hspace=0.0)
    figure = Figure(figsize=size, dpi=dpi, layout=close)
    FigureCanvasAgg(figure)
    return figure, figure.subplots(len(rows), columns, squeeze=False, gridspec_kw={"height_ratios": heights})
