"""Slices through a morph: where its two equations do not hold, with the contour of the surface on top."""

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
from nsm.cli.files import whole_file
from nsm.geometry.grid import Lattice, evaluate
from nsm.metrics.residuals import eikonal_residual, level_set_residual
from nsm.types import Morph

#: Times of the columns unless told otherwise.
TIMES = (0.25, 0.5, 0.75)
AXES = "xyz"
#: Points evaluated at once: the Jacobian of a velocity takes much more memory than a value.
_CHUNK = 1 << 14
#: Perceptually uniform, light where a residual is small, so that black lines are seen on it.
_COLOURS = "magma_r"
#: The colours end at this percentile of all residuals of a kind, as few places are far beyond.
_PERCENTILE = 99.0
#: Level sets that are drawn besides the surface, as a share of the longest edge of the box.
_LEVELS = 0.05
#: Inches: width of one picture, and of what stands around the pictures.
_PICTURE, _NAMES, _BAR, _TITLE = 1.7, 0.35, 0.75, 0.3

Residual = Callable[[Morph, Tensor, float], Tensor | None]
#: Which residuals are shown, and what stands beside their colours.
RESIDUALS: dict[str, Residual] = {
    "Eikonal  | ‖∇f‖ − 1 |": eikonal_residual,
    "level set  | ∂f/∂t + ⟨∇f, V⟩ |": level_set_residual,
}


class Plane(NamedTuple):
    """Where a slice of a morph in 3D lies; in 2D the whole plane is shown.

    Attributes:
        axis: x, y or z: the direction across the plane.
        offset: the coordinate of the plane along it.
    """

    axis: str = "z"
    offset: float = 0.0


#: The slice that is shown unless told otherwise.
MIDDLE = Plane()


class _Slice(NamedTuple):
    """What one picture shows: f and the residual (rows, columns), None without velocity; and its place."""

    values: np.ndarray
    residual: np.ndarray | None
    #: left, right, bottom, top.
    extent: tuple[float, float, float, float]


def plot_residual_slices(
    path: Path | str,
    morphs: Morph | Mapping[str, Morph],
    times: Sequence[float] = TIMES,
    plane: Plane = MIDDLE,
    *,
    resolution: int = 200,
) -> None:
    """Draw both residuals at some times, one row a residual and a morph; the surface is the strong line.

    Rows of one residual share their colours, whose bar stands beside them and ends at the 99th percentile. Thin lines
    are further level sets: where they crowd or part, f is no distance. A method without velocity has no level set
    residual, and no row for it.

    Args:
        path: the picture; its suffix chooses the format (.png, .pdf, .svg).
        morphs: one morph, or several of the same dimension by name; names are written beside the rows.
        times: of the columns.
        plane: where to cut (3D).
        resolution: pixels along the longest edge of the box.

    Raises:
        InputError: if morphs of 2 and 3 dimensions are to share a picture, there is nothing to draw, or the plane does
            not cut the box of a morph.
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
    figure, grid = _figure([row for parts in shown.values() for row in parts.values()], bool(any(rows)))
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
    with whole_file(path) as temporary:
        figure.savefig(temporary, facecolor="white")


def require_slices(rows: Mapping[str, Morph], times: Sequence[float], plane: Plane) -> None:
    """Refuse slices that cannot be drawn, before long work is done for them.

    Raises:
        InputError: as `plot_residual_slices` does.
    """
    dims = {morph.dim for morph in rows.values()}
    if len(dims) != 1 or not len(times):
        raise InputError(
            f"slices show morphs of one dimension at one time or more, not of dimensions {sorted(dims)} at "
            f"{len(times)} times: draw them separately"
        )
    outside = [time for time in times if not 0 <= time <= 1]
    if outside:
        raise InputError(f"there is no slice at the time {outside[0]:g}: give times from 0 to 1, such as [0.25,0.5]")
    if dims == {2}:
        return
    if plane.axis not in AXES or len(plane.axis) != 1:
        raise InputError(f"axis={plane.axis} is no direction to look along: give x, y or z")
    for morph in rows.values():
        low, high = morph.bounds[:, AXES.index(plane.axis)].tolist()
        if not low < plane.offset < high:
            raise InputError(
                f"offset={plane.offset:g} lies outside the box: give a coordinate {plane.axis} between {low:g} and "
                f"{high:g}"
            )


def _slice(morph: Morph, time: float, plane: Plane, residual: Residual, resolution: int) -> _Slice:
    """Values and residuals on the pixels of the plane, the lowest row first."""
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
    """The residual at the end of the colours."""
    values = [piece.residual for row in parts.values() for piece in row if piece.residual is not None]
    top = float(np.nanpercentile(np.concatenate([v.ravel() for v in values]), _PERCENTILE))
    # an exact morph has no residual but rounding, and should not look otherwise
    return max(top, 1e-4) if math.isfinite(top) else 1.0


def _draw(axis: Axes, piece: _Slice, scale: float) -> AxesImage:
    residual = np.full_like(piece.values, np.nan) if piece.residual is None else piece.residual
    image = axis.imshow(
        residual, extent=piece.extent, origin="lower", cmap=_COLOURS, vmin=0, vmax=scale, interpolation="bilinear"
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


def _figure(rows: Sequence[Sequence[_Slice]], named: bool) -> tuple[Figure, np.ndarray]:
    """A figure whose axes (rows, columns) have the shape of the slices."""
    heights = [_PICTURE * (p[0].extent[3] - p[0].extent[2]) / (p[0].extent[1] - p[0].extent[0]) for p in rows]
    columns = len(rows[0])
    size = (columns * _PICTURE + _BAR + (_NAMES if named else 0), sum(heights) + 0.05 * len(rows) + _TITLE)
    close = ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.02, wspace=0.0, hspace=0.0)
    figure = Figure(figsize=size, dpi=250, layout=close)
    FigureCanvasAgg(figure)
    return figure, figure.subplots(len(rows), columns, squeeze=False, gridspec_kw={"height_ratios": heights})
