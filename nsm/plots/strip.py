"""A morph as a strip of pictures: columns are times, rows are morphs."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from nsm.cli.errors import InputError
from nsm.cli.extras import MissingPackageError
from nsm.cli.files import whole_file
from nsm.plots.flat import PlaneDrawing
from nsm.plots.look import LOOK, Look, camera_for, surface
from nsm.plots.opengl import NoOpenGLError
from nsm.plots.studio import Studio
from nsm.types import Morph

log = logging.getLogger(__name__)

#: Times of the columns unless told otherwise.
TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)
#: Suffixes that a strip may have.
SUFFIXES = (".png", ".pdf", ".svg", ".jpg")
_DPI = 200
#: Space between drawings of 2D shapes, as a share of their width.
_GAP = 0.04
#: Size of names and times in points at 400 pixels a picture.
_FONT = 8
#: A row of a strip: height of its pictures as a share of their width, and what draws each of them.
Tiles = tuple[float, list[Callable[[Axes], object]]]
#: Told after each picture: how many are done, of how many.
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
    """Draw morphs at some times, one row a morph: surfaces in 3D, filled shapes with their level sets in 2D.

    All pictures of a row share a camera, which holds the surface at all times.

    Args:
        path: the picture; its suffix, one of `SUFFIXES`, chooses the format.
        morphs: one morph, or several of the same dimension by name; names are written beside the rows.
        times: of the columns.
        size: pixels across one picture.
        look: how fine, in which colors and from where.
        progress: told after each picture.

    Raises:
        InputError: if morphs of 2 and 3 dimensions are to share a picture, nothing is given, the suffix is unknown, or
            there is no OpenGL to draw surfaces with.
    """
    path, rows = Path(path), morphs if isinstance(morphs, Mapping) else {"": morphs}
    dims = {morph.dim for morph in rows.values()}
    if len(dims) != 1 or not len(times):
        raise InputError(
            f"a strip shows morphs of one dimension at one time or more, not of dimensions {sorted(dims)} at "
            f"{len(times)} times: draw them separately"
        )
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path} names no format of pictures: give a name that ends in {' or '.join(SUFFIXES)}")
    tiles: list[Tiles] = []
    for number, morph in enumerate(rows.values()):
        row = _Row(morph, times, size, look, partial(_tell, progress, number * len(times), len(rows) * len(times)))
        tiles.append(row.surfaces() if dims == {3} else row.shapes())
    figure, grid = _figure(tiles, len(times), size, bool(any(rows)), 0.0 if dims == {3} else _GAP)
    font = _FONT * max(size / 400, 0.5)
    for axes, name, (_, fills) in zip(grid, rows, tiles, strict=True):
        for axis, fill in zip(axes, fills, strict=True):
            fill(axis)
            axis.set_xticks([])
            axis.set_yticks([])
            axis.spines[:].set(visible=dims == {2}, color="0.8", linewidth=0.5)
        axes[0].set_ylabel(name, fontsize=font)
    for axis, time in zip(grid[-1], times, strict=True):
        axis.set_xlabel(f"t = {time:.3g}", fontsize=font)
    with whole_file(path) as temporary:
        figure.savefig(temporary, facecolor="white")


def try_strip(
    path: Path | str, morphs: Morph | Mapping[str, Morph], times: Sequence[float] = TIMES, *, size: int = 400
) -> bool:
    """Draw a strip as `render_strip` does, or warn that this machine cannot; whether it was drawn."""
    try:
        render_strip(path, morphs, times, size=size)
    except (MissingPackageError, NoOpenGLError) as error:
        log.warning("%s is left out: %s", path, error)
        return False
    return True


def _tell(progress: Progress, before: int, total: int, done: int) -> None:
    progress(before + done, total)


class _Row:
    """One morph at all times."""

    def __init__(
        self, morph: Morph, times: Sequence[float], size: int, look: Look, done: Callable[[int], object]
    ) -> None:
        self.morph, self.times, self.size, self.look, self.done = morph, times, size, look, done

    def surfaces(self) -> Tiles:
        """One rendered picture a time."""
        camera, levels = camera_for(self.morph, self.look, self.times), self.look.levels(self.morph)
        pictures = []
        with Studio(camera, self.size) as studio:
            for number, time in enumerate(self.times):
                pictures.append(studio.draw(surface(self.morph, time, levels(time), self.look)))
                self.done(number + 1)
        show = partial(Axes.imshow, interpolation="none", aspect="auto")
        return camera.aspect, [partial(show, X=picture) for picture in pictures]

    def shapes(self) -> Tiles:
        """One drawing a time."""
        drawing = PlaneDrawing(self.morph, self.look)

        def fill(axis: Axes, number: int) -> None:
            drawing.draw(axis, self.times[number], line=1.6 * self.size / 400)
            self.done(number + 1)

        return drawing.aspect, [partial(fill, number=number) for number in range(len(self.times))]


def _figure(tiles: Sequence[Tiles], columns: int, size: int, named: bool, gap: float) -> tuple[Figure, np.ndarray]:
    """A figure whose axes (rows, columns) have the size of the tiles to the pixel, with room for names and times."""
    label = 0.3 * max(size / 400, 0.5)
    margin = label if named else 0.0
    between = gap * size / _DPI
    tile, heights = size / _DPI, [max(1, round(size * aspect)) / _DPI for aspect, _ in tiles]
    # half a gap at the rims, or frames there would lose half their line
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
