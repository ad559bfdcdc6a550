"""From a field to the surface (3D) or curve (2D) where it takes a value."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from skimage.measure import find_contours, marching_cubes
from torch import Tensor

from nsm.geometry.grid import Lattice, sample_band
from nsm.types import SignedDistance, SimplexMesh

#: Values this close to the level, in cells, are moved inside: a surface through a corner of a cell is ambiguous, and
#: inside is right for the edges of boxes whose faces lie on the grid.
_OFF_LEVEL = 1e-5


def extract_surface(
    field: SignedDistance, bounds: Float[Tensor, "2 d"], resolution: int = 128, level: float = 0.0
) -> SimplexMesh:
    """Triangles (3D, marching cubes) or segments (2D, marching squares) where a field equals ``level``.

    The box is cut into ``resolution`` cells along its longest edge and the field is sampled at their corners
    (``resolution + 1`` along that edge), near the surface only; the result is that of the full grid. Vertices are
    shared between neighbouring simplices, so that counting them gives the Euler number. Triangles turn
    counter-clockwise seen from outside; segments run with the inside on their left. The surface is open where it
    leaves the box.

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
    lattice = Lattice.corners(bounds, resolution)
    values = sample_band(lambda x: field(x) - level, lattice).values.double().cpu().numpy()
    # in cells: neighbouring values then differ by about 1, and single precision (of marching cubes) resolves them
    values /= float(lattice.step.max())
    values[np.abs(values) < _OFF_LEVEL] = -_OFF_LEVEL
    if values.min() >= 0 or values.max() <= 0:
        vertices, simplices = np.empty((0, values.ndim)), np.empty((0, values.ndim), dtype=np.int64)
    elif values.ndim == 3:
        vertices, simplices, _, _ = marching_cubes(values, 0.0, gradient_direction="descent")
    else:
        vertices, simplices = _segments(find_contours(values, 0.0))
    index = torch.as_tensor(np.ascontiguousarray(vertices), dtype=bounds.dtype, device=bounds.device)
    faces = torch.as_tensor(np.ascontiguousarray(simplices), dtype=torch.long, device=bounds.device)
    return SimplexMesh(lattice.points(index), faces)


def _segments(contours: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and segments of polylines; one whose ends coincide is closed."""
    vertices, segments, first = [], [], 0
    for line in contours:
        closed = len(line) > 2 and bool((line[0] == line[-1]).all())
        line = line[:-1] if closed else line
        index = np.arange(first, first + len(line))
        following = np.roll(index, -1)
        pairs = np.stack([index, following], 1)
        vertices.append(line)
        segments.append(pairs if closed else pairs[:-1])
        first += len(line)
    return np.concatenate(vertices), np.concatenate(segments)
