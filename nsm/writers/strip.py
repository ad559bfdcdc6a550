"""A morph as a strip of pictures: columns are times, rows are morphs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch.nn.functional import normalize

from nsm.errors import InputError
from nsm.files import whole_file
from nsm.geometry.grid import Lattice, evaluate
from nsm.geometry.meshing import extract_surface
from nsm.types import Morph, SimplexMesh
from nsm.writers.raytrace import Camera, Scene, render

#: Times of the columns unless told otherwise.
TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)
#: Linear RGB of surfaces: a light clay that leaves room for shadows.
_CLAY = (0.40, 0.56, 0.84)
_DPI = 200
#: A row of a strip: height of its pictures as a share of their width, and what draws each of them.
Tiles = tuple[float, list[Callable[[Axes], object]]]


def render_strip(
    path: Path | str,
    morphs: Morph | Mapping[str, Morph],
    times: Sequence[float] = TIMES,
    *,
    size: int = 400,
    resolution: int = 160,
    up: Sequence[float] = (0.0, 1.0, 0.0),
    view: Sequence[float] = (0.55, 0.45, 1.0),
) -> None:
    """Draw morphs at some times, one row a morph: surfaces in 3D, filled shapes with their level sets in 2D.

    All pictures of a row share a camera, which holds the surface at all times.

    Args:
        path: the picture; its suffix chooses the format (.png, .pdf).
        morphs: one morph, or several of the same dimension by name; names are written beside the rows.
        times: of the columns.
        size: pixels across one picture.
        resolution: cells along the box for the surfaces.
        up: which way is up (3D).
        view: where the viewer stands (3D).

    Raises:
        InputError: if morphs of 2 and 3 dimensions are to share a picture, or nothing is given.
    """
    rows = morphs if isinstance(morphs, Mapping) else {"": morphs}
    dims = {morph.dim for morph in rows.values()}
    if len(dims) != 1 or not len(times):
        raise InputError(
            f"a strip shows morphs of one dimension at one time or more, not of dimensions {sorted(dims)} at "
            f"{len(times)} times: draw them separately"
        )
    draw = _surfaces if dims == {3} else _shapes
    tiles = [draw(morph, times, size, resolution, Pose(up, view)) for morph in rows.values()]
    figure, grid = _figure(tiles, len(times), size, bool(any(rows)))
    for axes, name, (_, row) in zip(grid, rows, tiles, strict=True):
        for axis, fill in zip(axes, row, strict=True):
            fill(axis)
            axis.set_xticks([])
            axis.set_yticks([])
            axis.spines[:].set(visible=dims == {2}, color="0.8", linewidth=0.5)
        axes[0].set_ylabel(name, fontsize=8)
    for axis, time in zip(grid[-1], times, strict=True):
        axis.set_xlabel(f"t = {time:.3g}", fontsize=8)
    with whole_file(path) as temporary:
        figure.savefig(temporary, facecolor="white")


class Pose(NamedTuple):
    """Which way is up, and where the viewer stands."""

    up: Sequence[float]
    view: Sequence[float]


def _figure(tiles: Sequence[Tiles], columns: int, size: int, named: bool) -> tuple[Figure, np.ndarray]:
    """A figure whose axes (rows, columns) have the size of the tiles to the pixel, with room for names and times."""
    margin = 0.3 if named else 0.0
    width = columns * size / _DPI
    heights = [round(size * aspect) / _DPI for aspect, _ in tiles]
    figure = Figure(figsize=(width + margin, sum(heights) + 0.3), dpi=_DPI)
    FigureCanvasAgg(figure)
    edges = {"left": margin / (width + margin), "right": 1, "top": 1, "bottom": 0.3 / (sum(heights) + 0.3)}
    ratios = {"height_ratios": heights, "wspace": 0, "hspace": 0}
    return figure, figure.subplots(len(tiles), columns, squeeze=False, gridspec_kw=edges | ratios)


def _surfaces(morph: Morph, times: Sequence[float], size: int, resolution: int, pose: Pose) -> Tiles:
    """One rendered picture a time."""
    meshes = [extract_surface(partial(morph, t=time), morph.bounds, resolution) for time in times]
    camera = _camera(meshes, np.asarray(pose.up, float), np.asarray(pose.view, float))
    scenes = (
        _scene(mesh, morph, time) if len(mesh.simplices) else None for mesh, time in zip(meshes, times, strict=True)
    )
    pictures = [render(scene, camera, size, _CLAY) for scene in scenes]
    return camera.aspect, [partial(Axes.imshow, X=picture, interpolation="none", aspect="auto") for picture in pictures]


def _scene(mesh: SimplexMesh, morph: Morph, time: float) -> Scene:
    normals = torch.cat([morph.gradient(part, time).detach() for part in mesh.vertices.split(1 << 15)])
    return Scene(*(a.cpu().numpy() for a in (mesh.vertices, mesh.simplices, normalize(normals, dim=1))))


def _camera(meshes: Sequence[SimplexMesh], up: np.ndarray, view: np.ndarray) -> Camera:
    """A camera that holds all meshes, on a floor below all of them."""
    points = torch.cat([mesh.vertices for mesh in meshes]).cpu().double().numpy()
    if not len(points):
        points = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    up = up / np.linalg.norm(up)
    camera = Camera(np.zeros(3), 1.0, view, up, float((points @ up).min()))
    seen = points @ camera.axes.T
    lowest, highest = seen.min(0), seen.max(0)
    centre = (lowest + highest) / 2 @ camera.axes
    # a margin around, of which the floor in front needs more than the air above
    width, height = (highest - lowest)[:2] / 2
    radius = 1.15 * max(width, 0.7 * height)
    aspect = float((1.08 * height + 0.12 * radius) / radius)
    return camera._replace(centre=centre, radius=float(radius), aspect=aspect)


def _shapes(morph: Morph, times: Sequence[float], size: int, resolution: int, pose: Pose) -> Tiles:
    """Insides filled, the zero set as a strong line, other level sets as faint ones; one drawing a time."""
    lattice = Lattice.corners(morph.bounds, resolution)
    ticks = [torch.arange(n, device=morph.bounds.device) for n in lattice.shape]
    points = lattice.points(torch.stack(torch.meshgrid(*ticks, indexing="ij"), -1))
    width, height = (morph.bounds[1] - morph.bounds[0]).tolist()
    steps = max(width, height) / 20 * torch.arange(-20, 21)
    levels = steps[steps != 0].tolist()

    def fill(axis: Axes, time: float) -> None:
        values = evaluate(partial(morph, t=time), points.view(-1, 2)).view(lattice.shape).cpu()
        place = points.cpu().unbind(-1)
        axis.contourf(*place, values, levels=[-1e9, 0], colors=["#C9DCF3"])
        axis.contour(*place, values, levels=levels, colors="0.82", linewidths=0.4, linestyles="-")
        if float(values.min()) < 0 < float(values.max()):
            axis.contour(*place, values, levels=[0.0], colors="#1F5FA8", linewidths=1.6)

    return height / width, [partial(fill, time=time) for time in times]
