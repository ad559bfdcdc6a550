"""Strips of pictures: one row per morph, one column per time."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.textpath import TextPath

from nsm.cli.errors import InputError
from nsm.cli.extras import MissingPackageError
from nsm.cli.files import atomic_write
from nsm.plots.flat import LevelSetDrawing
from nsm.plots.look import LOOK, Look, camera_for, surface
from nsm.plots.opengl import NoOpenGLError
from nsm.plots.renderer import SurfaceRenderer
from nsm.types import Morph

log = logging.getLogger(__name__)

#: Times of the columns by default.
TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)
#: File formats of a strip, by suffix.
SUFFIXES = (".png", ".pdf", ".svg", ".jpg")
_DPI = 200
#: Space between drawings of 2D shapes relative to their width.
_GAP = 0.04
#: Font size of names and times in points, at 400 pixels per picture.
_FONT = 8
#: A row of a strip: height of its pictures divided by their width, and functions that draw each of them on axes.
Tiles = tuple[float, list[Callable[[Axes], object]]]
#: Called after each picture with the number of pictures done and their total.
Progress = Callable[[int, int], object]


def render_strip(
    path: Path | str,
    morphs: Morph | Mapping[str, Morph],
    times: Sequence[float] = TIMES,
    *,
    size: int = 400,
    look: Look = LOOK,
    progress: Progress = lambda done, total: None,
) -> None:
    """Draw morphs at some times, one row per morph: surfaces in 3D, filled shapes with their level sets in 2D.

    All pictures of a row share a camera that holds the surface at all its times.

    Args:
        path: The picture to write; its suffix, one of `SUFFIXES`, selects the format.
        morphs: One morph, or several of the same dimension by name; names are written to the left of the rows.
        times: Times of the columns, in [0, 1].
        size: Width of one picture in pixels.
        look: Resolution, colors, and camera.
        progress: Called after each picture.

    Raises:
        InputError: If the morphs are of different dimensions, there are no times, the suffix is unknown, or surfaces
            cannot be drawn because there is no OpenGL.

    >>> import nsm
    >>> render_strip("strip.png", nsm.load_morph("outputs/demo"), [0, 0.5, 1], size=300)  # doctest: +SKIP
    """
    path, rows = Path(path), morphs if isinstance(morphs, Mapping) else {"": morphs}
    dims = {morph.dim for morph in rows.values()}
    if len(dims) != 1 or not len(times):
        raise InputError(
            f"The `morphs` of a strip must have one dimension, and be shown at one time or more, got dimensions "
            f"{sorted(dims)} at {len(times)} times. Try one strip for each dimension."
        )
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"The name of a strip must end in {' or '.join(SUFFIXES)}, got {path}. Try `output=strip.png`."
        )
    tiles: list[Tiles] = []
    for number, morph in enumerate(rows.values()):
        row = _Row(morph, times, size, look, partial(_tell, progress, number * len(times), len(rows) * len(times)))
        tiles.append(row.surfaces() if dims == {3} else row.drawings())
    font = _FONT * max(size / 400, 0.5)
    figure, grid = _figure(tiles, len(times), size, font, _width(rows, font), 0.0 if dims == {3} else _GAP)
    for axes, name, (_, fills) in zip(grid, rows, tiles, strict=True):
        for axis, fill in zip(axes, fills, strict=True):
            fill(axis)
            axis.set_xticks([])
            axis.set_yticks([])
            axis.spines[:].set(visible=dims == {2}, color="0.8", linewidth=0.5)
        axes[0].set_ylabel(name, fontsize=font, labelpad=font / 2, rotation=0, ha="right", va="center")
    for axis, time in zip(grid[-1], times, strict=True):
        axis.set_xlabel(f"t = {time:.3g}", fontsize=font)
    with atomic_write(path) as temporary:
        figure.savefig(temporary, facecolor="white")


def try_strip(
    path: Path | str, morphs: Morph | Mapping[str, Morph], times: Sequence[float] = TIMES, *, size: int = 400
) -> bool:
    """Draw a strip with `render_strip`, or warn that this machine cannot; returns whether it was drawn."""
    try:
        render_strip(path, morphs, times, size=size)
    except (MissingPackageError, NoOpenGLError) as error:
        log.warning("Skipped %s. %s", path, error)
        return False
    return True


def _tell(progress: Progress, before: int, total: int, done: int) -> None:
    progress(before + done, total)


class _Row:
    """One morph at all times of a strip."""

    def __init__(
        self, morph: Morph, times: Sequence[float], size: int, look: Look, done: Callable[[int], object]
    ) -> None:
        self.morph, self.times, self.size, self.look, self.done = morph, times, size, look, done

    def surfaces(self) -> Tiles:
        """Render one picture per time."""
        camera, levels = camera_for(self.morph, self.look, self.times), self.look.levels(self.morph)
        pictures = []
        with SurfaceRenderer(camera, self.size) as renderer:
            for number, time in enumerate(self.times):
                pictures.append(renderer.draw(surface(self.morph, time, levels(time), self.look)))
                self.done(number + 1)
        show = partial(Axes.imshow, interpolation="none", aspect="auto")
        return camera.aspect, [partial(show, X=picture) for picture in pictures]

    def drawings(self) -> Tiles:
        """Draw one 2D shape per time."""
        drawing = LevelSetDrawing(self.morph, self.look)

        def fill(axis: Axes, number: int) -> None:
            drawing.draw(axis, self.times[number], line=1.6 * self.size / 400)
            self.done(number + 1)

        return drawing.aspect, [partial(fill, number=number) for number in range(len(self.times))]


def _width(names: Iterable[str], font: float) -> float:
    """Width of the longest of the names of rows in inches."""
    return max((TextPath((0, 0), name, size=font).get_extents().width for name in names if name), default=0.0) / 72


def _figure(
    tiles: Sequence[Tiles], columns: int, size: int, font: float, names: float, gap: float
) -> tuple[Figure, np.ndarray]:
    """Lay out axes (rows, columns) that match the tiles to the pixel, with space for names and times."""
    label = 2.7 * font / 72
    margin = names + font / 72 if names else 0.0
    between = gap * size / _DPI
    tile, heights = size / _DPI, [max(1, round(size * aspect)) / _DPI for aspect, _ in tiles]
    # half a gap at the rims, so that the lines around drawings there keep their full width
    width = margin + columns * (tile + between)
    height = label + sum(heights) + len(tiles) * between
    figure = Figure(figsize=(width, height), dpi=_DPI)
    FigureCanvasAgg(figure)
    grid = np.empty((len(tiles), columns), dtype=object)
    top = height - between / 2
    for row, tall in enumerate(heights):
        for column in range(columns):
            left = margin + between / 2 + column * (tile + between)
            box = (left / width, (top - tall) / height, tile / width, tall / height)
            grid[row, column] = figure.add_axes(box)
        top -= tall + between
    return figure, grid
