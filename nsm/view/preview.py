"""Shapes from files as the page shows them, and the points on them that a user clicks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

from nsm.geometry.topology import vertex_normals
from nsm.io.gltf import encode_glb
from nsm.io.palette import CLAY
from nsm.io.shape_file import read_shape
from nsm.shapes import FieldShape, Shape, Similarity
from nsm.types import SimplexMesh
from nsm.view.flat import FlatShape, encode_flat
from nsm.view.stage import Extent

#: Number of points of a cloud that are shown, and half the edge of their squares in distances to the nearest point.
_SQUARES, _HALF_EDGE = 10_000, 1.2
#: Angle in radians between two triangles from which their edge looks sharp.
_SHARP = math.radians(40)


class Preview:
    """A shape from a file as triangles in the coordinates of the box.

    Args:
        path: The file.

    Attributes:
        path: The file.
        kind: Kind of the shape, such as ``mesh``.
        dim: Dimension of the shape.
        extent: Box around it.
        glb: Bytes of a GLB file that shows it.

    Raises:
        InputError: If the file cannot be read, or holds no shape.
    """

    @torch.no_grad()
    def __init__(self, path: Path) -> None:
        shape, self.path = read_shape(path), path
        origin = shape.provenance()
        self.kind, self.dim = str(origin["kind"]), shape.dim
        self._similarity = Similarity.read(origin["similarity"], shape.dim)
        triangles, self.glb = _triangles(shape)
        self._corners = triangles.vertices.double().numpy()[triangles.simplices.numpy()]
        points = self._corners.reshape(-1, 3)
        self.extent = Extent(points.min(0), points.max(0))

    def pick(
        self, origin: Float[np.ndarray, " 3"], direction: Float[np.ndarray, " 3"]
    ) -> Float[np.ndarray, " 3"] | None:
        """Find the point at which a ray first meets the shape, shape (3,); None if it does not."""
        return first_hit(self._corners, origin, direction)

    def in_file(self, point: Float[np.ndarray, " 3"]) -> list[float]:
        """Map a point of the box to the coordinates of the file, d numbers."""
        return self._similarity.pull_back(torch.from_numpy(point[None, : self.dim]).double())[0].tolist()

    def in_box(self, point: Sequence[float]) -> Float[np.ndarray, " 3"]:
        """Map a point in the coordinates of the file to the box, shape (3,)."""
        placed = self._similarity.apply(torch.tensor([point], dtype=torch.float64))[0].numpy()
        return np.concatenate([placed, np.zeros(3 - self.dim)])


def first_hit(
    corners: Float[np.ndarray, "m 3 3"], origin: Float[np.ndarray, " 3"], direction: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " 3"] | None:
    """Intersect a ray with triangles, from either side.

    Args:
        corners: Corners of the triangles, shape (m, 3, 3).
        origin: Origin of the ray, shape (3,).
        direction: Direction of the ray, shape (3,).

    Returns:
        The intersection that is nearest to the origin, shape (3,), or None.

    References:
        Möller and Trumbore, Fast, Minimum Storage Ray/Triangle Intersection, 1997.
        https://doi.org/10.1080/10867651.1997.10487468

    >>> triangle = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    >>> first_hit(triangle, np.array([0.2, 0.3, 5.0]), np.array([0.0, 0.0, -2.0])).tolist()
    [0.2, 0.3, 0.0]
    """
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(direction, v)
    determinant = np.einsum("ij,ij->i", u, across)
    with np.errstate(divide="ignore", invalid="ignore"):  # parallel triangles give no number, which no test passes
        first = np.einsum("ij,ij->i", origin - a, across) / determinant
        along = np.cross(origin - a, u)
        second = along @ direction / determinant
        distance = np.einsum("ij,ij->i", v, along) / determinant
        hit = (first >= 0) & (second >= 0) & (first + second <= 1) & (distance > 0)
    if not hit.any():
        return None
    return np.asarray(origin + distance[hit].min() * direction)


def _triangles(shape: Shape) -> FlatShape:
    if shape.dim == 2:
        assert isinstance(shape, FieldShape)  # all shapes in the plane have a field
        low, high = shape.bounds()
        return encode_flat(shape.surface(), shape, 0.0, float((high - low).max()))
    mesh = _shaded(shape.surface()) if isinstance(shape, FieldShape) else _squares(shape)
    normals, colors = vertex_normals(mesh), torch.tensor(CLAY).expand(len(mesh.vertices), 3)
    return FlatShape(mesh, encode_glb(mesh, normals, colors))


def _shaded(mesh: SimplexMesh) -> SimplexMesh:
    """Split a surface along its sharp edges, so that they stay sharp where normals are interpolated."""
    whole = trimesh.Trimesh(mesh.vertices.numpy(), mesh.simplices.numpy(), process=False)
    split = trimesh.graph.smooth_shade(whole, angle=_SHARP)
    return SimplexMesh(torch.from_numpy(split.vertices).float(), torch.from_numpy(split.faces).long())


def _squares(cloud: Shape) -> SimplexMesh:
    """A square at each of some points of a cloud, at a right angle to its normal."""
    points, normals = cloud.surface_samples(_SQUARES, torch.Generator().manual_seed(0))
    points = torch.from_numpy(np.unique(torch.cat([points, normals], 1).numpy(), axis=0))
    points, normals = points[:, :3], points[:, 3:]
    nearest = cKDTree(points.numpy()).query(points.numpy(), k=2)[0][:, 1]
    half = _HALF_EDGE * float(np.median(nearest))
    helper = torch.eye(3)[normals.abs().argmin(1)].to(normals)
    u = torch.nn.functional.normalize(torch.linalg.cross(normals, helper), dim=1) * half
    v = torch.linalg.cross(normals, u)
    corners = torch.stack([points - u - v, points + u - v, points + u + v, points - u + v], 1)
    first = 4 * torch.arange(len(points))[:, None]
    triangles: Tensor = torch.cat([first + torch.tensor([0, 1, 2]), first + torch.tensor([0, 2, 3])])
    return SimplexMesh(corners.reshape(-1, 3), triangles)
