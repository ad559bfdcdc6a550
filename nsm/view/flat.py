"""A 2D shape as triangles in space: its inside filled, its outline a ribbon."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import Delaunay, QhullError
from torch import Tensor

from nsm.geometry.topology import simplex_normals
from nsm.types import SignedDistance, SimplexMesh

#: The outline lies this far before the inside, and on either side of it, in shares of the box's edge.
_LIFT, _SIDE = 0.002, 0.004

Triangles = tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "m 3"]]


def filled(mesh: SimplexMesh, field: SignedDistance, level: float) -> Triangles:
    """Triangles (v, 3), (m, 3) in the plane z = 0 that cover {f < level}.

    They are those of the Delaunay triangulation of the outline's vertices whose middles lie inside: vertices a cell
    apart sample an outline densely enough for its segments to be edges.

    Args:
        mesh: the outline, segments in 2D.
        field: f, maps points (n, 2) to values (n,).
        level: the value of f on the outline.
    """
    points = mesh.vertices.cpu().double().numpy()
    try:
        triangles = Delaunay(points).simplices
    except (QhullError, ValueError):  # fewer than three points, or all of them on a line: there is no inside
        triangles = np.empty((0, 3), dtype=np.int32)
    middles = torch.from_numpy(points[triangles].mean(1)).to(mesh.vertices)
    triangles = triangles[(field(middles) < level).cpu().numpy()] if len(triangles) else triangles
    return _in_space(points, 0.0), _facing(points, triangles)


def ribbon(mesh: SimplexMesh, edge: float) -> Triangles:
    """Triangles of a band along each segment, just before the plane; their vertices are four a segment.

    The first two belong to the segment's first vertex, the last two to its second.

    Args:
        mesh: segments in 2D.
        edge: of the box, which sets how wide the band is.
    """
    ends = mesh.vertices[mesh.simplices]
    side = torch.nn.functional.normalize(simplex_normals(mesh), dim=1) * (_SIDE * edge)
    along = torch.stack([-side[:, 1], side[:, 0]], 1) / 2  # so that neighboring bands meet without a notch
    corners: list[Tensor] = [ends[:, 0] - along - side, ends[:, 0] - along + side]
    corners += [ends[:, 1] + along - side, ends[:, 1] + along + side]
    points = torch.stack(corners, 1).reshape(-1, 2).cpu().double().numpy()
    first = 4 * np.arange(len(ends))[:, None]
    triangles = np.concatenate([first + np.array([0, 1, 2]), first + np.array([1, 3, 2])])
    return _in_space(points, _LIFT * edge), _facing(points, triangles)


def _in_space(points: np.ndarray, height: float) -> np.ndarray:
    return np.column_stack([points, np.full(len(points), height)])


def _facing(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The triangles turned counter-clockwise, so that their normals point to the viewer."""
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    u, v = b - a, c - a
    turned = u[:, 0] * v[:, 1] < u[:, 1] * v[:, 0]
    return np.where(turned[:, None], triangles[:, ::-1], triangles)
