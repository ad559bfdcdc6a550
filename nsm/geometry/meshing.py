"""From a field to the surface (3D) or curve (2D) where it takes a value."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from skimage.measure import find_contours, marching_cubes
from torch import Tensor

from nsm.geometry.grid import Band, Lattice, sample_band
from nsm.types import SignedDistance, SimplexMesh

#: Values this close to the level, in cells, are moved inside: a surface through a corner of a cell is ambiguous, and
#: inside is right for the edges of boxes whose faces lie on the grid.
OFF_LEVEL = 1e-5
#: Marching cubes is shown values between these, in cells at slope 1. Its vertices then lie well within the edges of the
#: lattice, by which they are told apart; where on an edge is worked out again, from the values themselves.
_LEAST, _MOST = 1e-4, 10.0
#: A vertex is on a face of a box when it is this close, in edges of the box.
_ON_FACE = 1e-6
#: Names of the sides of a box, by axis: lower and upper.
_AXES = "xyz"


def extract_surface(
    field: SignedDistance, bounds: Float[Tensor, "2 d"], resolution: int = 128, level: float = 0.0
) -> SimplexMesh:
    """Triangles (3D, marching cubes) or segments (2D, marching squares) where a field equals ``level``.

    The box is cut into ``resolution`` cells along its longest edge and the field is sampled at their corners
    (``resolution + 1`` along that edge), near the surface only; the result is that of the full grid. Vertices are
    shared between neighbouring simplices, so that counting them gives the Euler number. Triangles turn
    counter-clockwise seen from outside; segments run with the inside on their left. The surface is open where it
    leaves the box (`open_sides`).

    Args:
        field: maps points (n, d) to values (n,), lower inside.
        bounds: corners (2, d) of the box.
        resolution: cells along the longest edge of the box.
        level: the value to extract.

    Returns:
        The mesh, with dtype and device of ``bounds``; of no vertices and no simplices where the level is not met.

    References:
        Lewiner et al., Efficient implementation of Marching Cubes' cases with topological guarantees, JGT 2003.
    """
    return surface_in_band(sample_band(lambda x: field(x) - level, Lattice.corners(bounds, resolution)))


def surface_in_band(band: Band, level: float = 0.0) -> SimplexMesh:
    """The surface at a level that is within the reach of a band of samples at the corners of cells."""
    lattice = band.lattice
    find = _triangles if len(lattice.shape) == 3 else _segments
    vertices, simplices = find(band, level)
    index = torch.as_tensor(vertices, dtype=lattice.step.dtype, device=lattice.step.device)
    return SimplexMesh(lattice.points(index), torch.as_tensor(simplices, device=lattice.step.device))


def open_sides(mesh: SimplexMesh, bounds: Float[Tensor, "2 d"]) -> list[str]:
    """Sides of a box where a surface reaches it, and so is cut off or goes on outside: of ``-x``, ``+x``, ``-y``, …"""
    if not len(mesh.vertices):
        return []
    margin = _ON_FACE * (bounds[1] - bounds[0])
    below = (mesh.vertices <= bounds[0] + margin).any(0).tolist()
    above = (mesh.vertices >= bounds[1] - margin).any(0).tolist()
    return [
        sign + _AXES[axis]
        for axis in range(len(below))
        for sign, reached in (("-", below), ("+", above))
        if reached[axis]
    ]


def _cell_units(values: Tensor, level: float, step: float) -> np.ndarray:
    """Values less the level, in cells, so that those of a distance differ by about 1 between neighbours; none is 0."""
    array = (values.double().cpu().numpy() - level) / step
    array[np.abs(array) < OFF_LEVEL] = -OFF_LEVEL
    return array


def _triangles(band: Band, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, as indices into the lattice, and triangles: marching cubes on bricks, welded along their faces."""
    keys, vertices, triangles, count = [], [], [], 0
    step = float(band.lattice.step.max())
    for window, _ in band.bricks(after=1):
        values = _cell_units(window.values, level, step)
        if min(values.shape) < 2 or values.min() >= 0 or values.max() <= 0:
            continue
        shown = np.copysign(np.clip(np.abs(values) / band.slope, _LEAST, _MOST), values).astype(np.float32)
        found, faces, _, _ = marching_cubes(shown, 0.0, gradient_direction="descent")
        places, edges = _on_edges(found, values)
        cell = np.ravel_multi_index(tuple((edges[:, :3] + window.low).T), band.lattice.shape)
        keys.append(4 * cell + edges[:, 3])
        vertices.append(places + window.low)
        triangles.append(faces.astype(np.int64) + count)
        count += len(found)
    if not count:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    _, first, number = np.unique(np.concatenate(keys), return_index=True, return_inverse=True)
    return np.concatenate(vertices)[first], number[np.concatenate(triangles)]


def _on_edges(found: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the vertices of marching cubes lie to double precision, and which edge of the lattice each is on.

    Returns:
        Indices (v, 3), fractions included; and (v, 4): the edge's lower end and its axis, or for the rare vertex in the
        middle of a cell the cell and 3.
    """
    lower = np.floor(found).astype(np.int64)
    between = found != lower
    axis = np.where(between.sum(1) == 1, between.argmax(1), 3)
    places, on_edge = found.astype(np.float64), np.flatnonzero(axis < 3)
    start, along = lower[on_edge], axis[on_edge]
    end = start.copy()
    end[np.arange(len(end)), along] += 1
    before, after = values[tuple(start.T)], values[tuple(end.T)]
    places[on_edge, along] = start[np.arange(len(start)), along] + before / (before - after)
    return places, np.column_stack([lower, axis])


def _segments(band: Band, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, as indices into the lattice, and segments."""
    values = _cell_units(band.whole().values, level, float(band.lattice.step.max()))
    if min(values.shape) < 2 or values.min() >= 0 or values.max() <= 0:
        return np.empty((0, 2)), np.empty((0, 2), dtype=np.int64)
    vertices, segments, first = [], [], 0
    for line in find_contours(values, 0.0):
        closed = len(line) > 2 and bool((line[0] == line[-1]).all())
        line = line[:-1] if closed else line
        index = np.arange(first, first + len(line))
        pairs = np.stack([index, np.roll(index, -1)], 1)
        vertices.append(line)
        segments.append(pairs if closed else pairs[:-1])
        first += len(line)
    return np.concatenate(vertices), np.concatenate(segments)
