"""2D shapes as triangles in space: a filled inside, and a ribbon along the outline."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import Delaunay, QhullError
from torch import Tensor
from torch.nn.functional import normalize

from nsm.geometry.topology import simplex_normals
from nsm.io.gltf import encode_glb
from nsm.io.palette import INSIDE, OUTLINE
from nsm.types import SignedDistance, SimplexMesh

#: Height of the outline above the inside, and half its width, relative to the edge of the box.
_LIFT, _SIDE = 0.002, 0.004


class FlatShape(NamedTuple):
    """A 2D shape as triangles in space, and as the bytes of a GLB file."""

    triangles: SimplexMesh
    glb: bytes


def filled(mesh: SimplexMesh, field: SignedDistance, level: float) -> SimplexMesh:
    """Cover {f < level} with triangles in the plane z = 0.

    Of the Delaunay triangulation of the outline's vertices, these are the triangles whose centroids lie inside.
    Vertices one cell apart sample an outline densely enough for its segments to be edges of the triangulation.

    Args:
        mesh: The outline, segments in 2D.
        field: f, which maps points (n, 2) to values (n,).
        level: Value of f on the outline.

    Returns:
        Triangles in 3D, counter-clockwise.
    """
    points = mesh.vertices.cpu().double()
    try:
        triangles = torch.from_numpy(Delaunay(points.numpy()).simplices.astype(np.int64))
    except (QhullError, ValueError):  # fewer than three points, or all of them on a line: there is no inside
        triangles = torch.empty((0, 3), dtype=torch.long)
    centroids = points[triangles].mean(1).to(mesh.vertices)
    triangles = triangles[(field(centroids) < level).cpu()] if len(triangles) else triangles
    return _in_space(points, triangles, 0.0)


def ribbon(mesh: SimplexMesh, edge: float) -> SimplexMesh:
    """Lay a band of triangles along each segment, just in front of the plane z = 0.

    Each segment has four vertices: the first two at its first end, the last two at its second.

    Args:
        mesh: Segments in 2D.
        edge: Edge of the box, relative to which the band has its width.

    Returns:
        Triangles in 3D, counter-clockwise.
    """
    ends = mesh.vertices[mesh.simplices.long()].cpu().double()
    side = normalize(simplex_normals(mesh), dim=1).cpu().double() * (_SIDE * edge)
    along = torch.stack([-side[:, 1], side[:, 0]], 1) / 2  # bands overlap by this, or there would be notches
    corners: list[Tensor] = [ends[:, 0] - along - side, ends[:, 0] - along + side]
    corners += [ends[:, 1] + along - side, ends[:, 1] + along + side]
    first = 4 * torch.arange(len(ends))[:, None]
    triangles = torch.cat([first + torch.tensor([0, 1, 2]), first + torch.tensor([1, 3, 2])])
    return _in_space(torch.stack(corners, 1).reshape(-1, 2), triangles, _LIFT * edge)


def encode_flat(
    outline: SimplexMesh,
    field: SignedDistance,
    level: float,
    edge: float,
    colors: Float[Tensor, "v 3"] | None = None,
) -> FlatShape:
    """Cover the inside of a 2D shape in one color and draw its outline, as the page shows it.

    Args:
        outline: Segments in 2D.
        field: f, which maps points (n, 2) to values (n,).
        level: Value of f on the outline.
        edge: Edge of the box.
        colors: Colors of the outline at its vertices, sRGB in 0..1; None for the color of outlines.
    """
    inside, band = filled(outline, field, level), ribbon(outline, edge)
    count, line = len(inside.vertices), torch.tensor(OUTLINE).expand(len(band.vertices), 3)
    if colors is not None:
        # each segment has two vertices of the band at either end
        line = colors[outline.simplices.long()].repeat_interleave(2, dim=1).reshape(-1, 3).cpu()
    vertices = torch.cat([inside.vertices, band.vertices])
    triangles = SimplexMesh(vertices, torch.cat([inside.simplices, band.simplices + count]))
    normals = torch.tensor([0.0, 0.0, 1.0]).expand(len(vertices), 3)
    shades = torch.cat([torch.tensor(INSIDE).expand(count, 3), line.float()])
    return FlatShape(triangles, encode_glb(triangles, normals, shades))


def _in_space(points: Tensor, triangles: Tensor, height: float) -> SimplexMesh:
    """Triangles at a height, turned counter-clockwise, so that their normals point to the viewer."""
    a, b, c = points[triangles].unbind(1)
    u, v = b - a, c - a
    clockwise = u[:, 0] * v[:, 1] < u[:, 1] * v[:, 0]
    vertices = torch.cat([points, points.new_full((len(points), 1), height)], 1)
    return SimplexMesh(vertices, torch.where(clockwise[:, None], triangles.flip(1), triangles))
