"""Extraction of level sets: surfaces in 3D, curves in 2D."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from skimage.measure import find_contours, marching_cubes
from torch import Tensor

from nsm.geometry.band import Band, sample_band
from nsm.geometry.grid import Lattice
from nsm.types import SignedDistance, SimplexMesh

#: Values this close to the level, in cells, are moved inside. A surface through a corner of a cell is ambiguous, and
#: inside is correct for the edges of boxes whose faces lie on the grid.
OFF_LEVEL = 1e-5
#: Range of the values passed to marching cubes, in cells at slope 1. Its vertices then lie well inside the edges of the
#: lattice, which identify them; their exact positions are recomputed from the original values.
_MIN_VALUE, _MAX_VALUE = 1e-4, 10.0
#: Distance at which a vertex counts as lying on a face of the box, relative to the edge of the box.
_ON_FACE = 1e-6
#: Names of the axes of a box.
_AXES = "xyz"


def extract_surface(
    field: SignedDistance, bounds: Float[Tensor, "2 d"], resolution: int = 128, level: float = 0.0
) -> SimplexMesh:
    """Extract a level set as triangles (3D, marching cubes) or segments (2D, marching squares).

    The box is divided into ``resolution`` cells along its longest edge. The field is sampled at their corners near the
    surface only, and the result is that of the full grid. Neighboring simplices share vertices, so that the Euler
    number can be counted. Triangles are counterclockwise seen from outside; segments have the inside on their left. The
    surface is open where it leaves the box (`open_sides`).

    Args:
        field: A field that maps points, shape (n, d), to values, shape (n,), lower inside.
        bounds: Corners of the box, shape (2, d).
        resolution: Number of cells along the longest edge of the box.
        level: The value of the field on the surface.

    Returns:
        The mesh, with dtype and device of ``bounds``. It is empty if the field does not take the value.

    References:
        Lewiner et al., Efficient Implementation of Marching Cubes' Cases with Topological Guarantees, Journal of
        Graphics Tools 2003. https://doi.org/10.1080/10867651.2003.10487582

    Example:
        >>> import torch
        >>> from nsm.geometry.meshing import extract_surface
        >>> from nsm.geometry.topology import euler_number
        >>> box = torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
        >>> mesh = extract_surface(lambda x: x.norm(dim=1) - 0.5, box, resolution=32)
        >>> euler_number(mesh)
        2
    """
    return surface_in_band(sample_band(lambda x: field(x) - level, Lattice.corners(bounds, resolution)))


def surface_in_band(band: Band, level: float = 0.0) -> SimplexMesh:
    """Extract the surface at a level within the reach of a band of samples at the corners of cells."""
    lattice = band.lattice
    find = _triangles if len(lattice.shape) == 3 else _segments
    vertices, simplices = find(band, level)
    index = torch.as_tensor(vertices, dtype=lattice.step.dtype, device=lattice.step.device)
    return SimplexMesh(lattice.points(index), torch.as_tensor(simplices, device=lattice.step.device))


def open_sides(mesh: SimplexMesh, bounds: Float[Tensor, "2 d"]) -> list[str]:
    """List the sides of a box, of ``-x``, ``+x``, ``-y``, …, where a surface reaches it and is therefore open."""
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
    """Subtract the level and divide by the cell size, so that neighbors differ by about 1; none is 0."""
    array = (values.double().cpu().numpy() - level) / step
    array[np.abs(array) < OFF_LEVEL] = -OFF_LEVEL
    return array


def _triangles(band: Band, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Extract vertices, as fractional indices into the lattice, and triangles, brick by brick, and weld the bricks."""
    keys, vertices, triangles, count = [], [], [], 0
    step = float(band.lattice.step.max())
    for window, _ in band.bricks(after=1):
        values = _cell_units(window.values, level, step)
        if min(values.shape) < 2 or values.min() >= 0 or values.max() <= 0:
            continue
        clipped = np.copysign(np.clip(np.abs(values) / band.slope, _MIN_VALUE, _MAX_VALUE), values).astype(np.float32)
        found, faces, _, _ = marching_cubes(clipped, 0.0, gradient_direction="descent")
        positions, edges = _on_edges(found, values)
        cell = np.ravel_multi_index(tuple((edges[:, :3] + window.low).T), band.lattice.shape)
        keys.append(4 * cell + edges[:, 3])
        vertices.append(positions + window.low)
        triangles.append(faces.astype(np.int64) + count)
        count += len(found)
    if not count:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    _, first, number = np.unique(np.concatenate(keys), return_index=True, return_inverse=True)
    return np.concatenate(vertices)[first], number[np.concatenate(triangles)]


def _on_edges(found: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Recompute the vertices of marching cubes in double precision, and identify the edges of the lattice they lie on.

    Returns:
        Fractional indices, shape (v, 3); and the lower end and the axis of each edge, shape (v, 4), or the cell and 3
        for the rare vertex inside a cell.
    """
    lower = np.floor(found).astype(np.int64)
    between = found != lower
    axis = np.where(between.sum(1) == 1, between.argmax(1), 3)
    positions, on_edge = found.astype(np.float64), np.flatnonzero(axis < 3)
    start, along = lower[on_edge], axis[on_edge]
    end = start.copy()
    end[np.arange(len(end)), along] += 1
    before, after = values[tuple(start.T)], values[tuple(end.T)]
    positions[on_edge, along] = start[np.arange(len(start)), along] + before / (before - after)
    return positions, np.column_stack([lower, axis])


def _segments(band: Band, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Extract vertices, as fractional indices into the lattice, and segments."""
    values = _cell_units(band.whole().values, level, float(band.lattice.step.max()))
    if min(values.shape) < 2 or values.min() >= 0 or values.max() <= 0:
        return np.empty((0, 2)), np.empty((0, 2), dtype=np.int64)
    vertices, segments, first = [], [], 0
    for line in find_contours(values, 0.0):
        closed = len(line) > 2 and bool((line[0] == line[-1]).all())
        line = line[:-1] if closed else line
        index = np.arange(first, first + len(line))
        ends = np.stack([index, np.roll(index, -1)], 1)
        vertices.append(line)
        segments.append(ends if closed else ends[:-1])
        first += len(line)
    return np.concatenate(vertices), np.concatenate(segments)
