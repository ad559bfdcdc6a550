"""A morph as a strip of pictures: columns are times, rows are morphs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch import Tensor
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
        size: pixels along an edge of one picture.
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
    margin = 0.3 if any(rows) else 0.0
    tile = size / 200
    figure = Figure(figsize=(tile * len(times) + margin, tile * len(rows) + 0.3), dpi=200)
    FigureCanvasAgg(figure)
    grid = figure.subplots(
        len(rows),
        len(times),
        squeeze=False,
        gridspec_kw={
            "left": margin / figure.get_figwidth(),
            "right": 1,
            "top": 1,
            "bottom": 0.3 / figure.get_figheight(),
            "wspace": 0,
            "hspace": 0,
        },
    )
    for axes, (name, morph) in zip(grid, rows.items(), strict=True):
        if morph.dim == 3:
            _draw_surfaces(axes, morph, times, size, resolution, np.asarray(up, float), np.asarray(view, float))
        else:
            _draw_shapes(axes, morph, times, resolution)
        axes[0].set_ylabel(name, fontsize=8)
    for axis, time in zip(grid[-1], times, strict=True):
        axis.set_xlabel(f"t = {time:.3g}", fontsize=8)
    with whole_file(path) as temporary:
        figure.savefig(temporary, facecolor="white")


def _draw_surfaces(
    row: np.ndarray, morph: Morph, times: Sequence[float], size: int, resolution: int, up: np.ndarray, view: np.ndarray
) -> None:
    meshes = [extract_surface(partial(morph, t=time), morph.bounds, resolution) for time in times]
    camera = _camera(meshes, up, view)
    for axis, mesh, time in zip(row, meshes, times, strict=True):
        scene = _scene(mesh, morph, time) if len(mesh.simplices) else None
        axis.imshow(render(scene, camera, size, _CLAY), interpolation="none")
        _bare(axis)


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
    return camera._replace(centre=centre, radius=float((highest - lowest)[:2].max() / 2 * 1.15))


def _draw_shapes(row: np.ndarray, morph: Morph, times: Sequence[float], resolution: int) -> None:
    """Insides filled, the zero set as a strong line, other level sets as faint ones."""
    lattice = Lattice.corners(morph.bounds, resolution)
    ticks = [torch.arange(n, device=morph.bounds.device) for n in lattice.shape]
    index = torch.stack(torch.meshgrid(*ticks, indexing="ij"), -1)
    points = lattice.points(index)
    x, y = points.cpu().unbind(-1)
    spacing = float((morph.bounds[1] - morph.bounds[0]).max()) / 20
    for axis, time in zip(row, times, strict=True):
        values: Tensor = evaluate(partial(morph, t=time), points.view(-1, 2)).view(lattice.shape).cpu()
        axis.contourf(x, y, values, levels=[-1e9, 0], colors=["#C9DCF3"])
        levels = spacing * torch.arange(-20, 21)
        axis.contour(x, y, values, levels=levels[levels != 0].tolist(), colors="0.82", linewidths=0.4, linestyles="-")
        if float(values.min()) < 0 < float(values.max()):
            axis.contour(x, y, values, levels=[0.0], colors="#1F5FA8", linewidths=1.6)
        axis.set_aspect("equal")
        _bare(axis)


def _bare(axis) -> None:
    axis.set_xticks([])
    axis.set_yticks([])
    axis.spines[:].set_visible(False)
