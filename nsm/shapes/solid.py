"""The boundary of the solid described by a mesh with holes or overlapping parts."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from nsm.geometry.grid import CHUNK
from nsm.geometry.meshing import extract_surface
from nsm.geometry.triangles import Triangles

#: Number of cells along the longest side of the mesh, at which holes are closed and overlapping triangles are split.
_CELLS = 128
#: Offset from a triangle at which the winding number is evaluated, relative to the size of the mesh.
_OFFSET = 1e-5
#: Barycentric coordinates of the samples on a triangle: near its corners and at its center.
_SAMPLES = torch.tensor([[0.9, 0.05, 0.05], [0.05, 0.9, 0.05], [0.05, 0.05, 0.9], [1 / 3, 1 / 3, 1 / 3]])
#: Edge length, in cells, above which triangles are split unless all their samples are exposed.
_MAX_EDGE = 4
#: Maximum deviation of the winding number from 1/2 on the closing of a hole; at a triangle it jumps from 0 to 1.
_HALF = 0.2
#: Number of cells by which the winding number is scaled to a length that exceeds the distance near triangles.
_STEEPNESS = 8


def solid_boundary(vertices: np.ndarray, faces: np.ndarray, is_open: bool) -> tuple[np.ndarray, np.ndarray]:
    """Compute triangles on the boundary of the set where the winding number of a mesh exceeds 1/2.

    Parts of triangles with the inside on both sides, or on neither, are removed, so that distances are those to the
    surface of the solid. Holes are closed where the winding number is 1/2.

    Args:
        vertices: Vertices in double precision, shape (v, 3).
        faces: Triangles with outward normals, shape (m, 3).
        is_open: Whether the mesh may have holes.

    Returns:
        Vertices and triangles of the boundary; the same objects if nothing changes.
    """
    mesh = Triangles(vertices, faces)
    cell = float(np.ptp(vertices, axis=0).max()) / _CELLS
    corners = torch.from_numpy(vertices)[torch.from_numpy(faces)]
    parts = [_exposed_parts(mesh, corners, cell)]
    if is_open:
        parts.append(_closings(mesh, cell))
    elif len(parts[0]) == len(corners):
        return vertices, faces
    soup = torch.cat(parts).reshape(-1, 3).numpy()
    unique, index = np.unique(soup, axis=0, return_inverse=True)
    return unique, index.reshape(-1, 3).astype(np.int64)


def _exposed_parts(mesh: Triangles, corners: Tensor, cell: float) -> Tensor:
    """Compute the parts of triangles with the inside just below and the outside just above, shape (k, 3, 3)."""
    whole = torch.arange(len(corners))  # the triangle that each part belongs to
    parts, kept, owners = corners, [corners[:0]], [whole[:0]]
    intact = torch.ones(len(corners), dtype=torch.bool)
    max_edge = _MAX_EDGE * cell
    while len(parts):
        seen = _exposed(mesh, parts)
        longest = (parts - parts.roll(1, 1)).norm(dim=2).amax(1)
        mixed = seen.any(1) & ~seen.all(1)
        cut = (mixed & (longest > cell)) | (~seen.all(1) & (longest > max_edge))
        keep = torch.where(mixed, seen[:, 3], seen.all(1)) & ~cut
        intact[whole[~keep & ~cut]] = False
        kept.append(parts[keep])
        owners.append(whole[keep])
        whole = whole[cut].repeat(4)
        parts = _quartered(parts[cut])
    pieces, owner = torch.cat(kept), torch.cat(owners)
    return torch.cat([corners[intact], pieces[~intact[owner]]])


def _exposed(mesh: Triangles, corners: Tensor) -> Tensor:
    """Check at the samples of triangles, shape (n, 4), that the inside is just below and the outside just above."""
    normals = nn.functional.normalize(torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    offset = _OFFSET * float(np.ptp(mesh.vertices, axis=0).max()) * normals[:, None]
    at = torch.einsum("pk,nkd->npd", _SAMPLES.to(corners), corners)
    above, below = (
        mesh.winding_number(side.reshape(-1, 3)).view(len(corners), -1) for side in (at + offset, at - offset)
    )
    return (above <= 0.5) & (below > 0.5)


def _quartered(corners: Tensor) -> Tensor:
    """Split triangles into four at the midpoints of their edges."""
    a, b, c = corners.unbind(1)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return torch.cat([torch.stack(quarter, 1) for quarter in quarters])


def _closings(mesh: Triangles, cell: float) -> Tensor:
    """Compute triangles that close the holes where the winding number is 1/2, shape (k, 3, 3)."""

    def field(x: Tensor) -> Tensor:
        winding = mesh.winding_number(x) - 0.5
        distance = (_STEEPNESS * cell * winding.abs()).minimum(mesh.closest(x).distances)
        return torch.where(winding > 0, -distance, distance)

    low, high = torch.from_numpy(mesh.vertices.min(0)), torch.from_numpy(mesh.vertices.max(0))
    surface = extract_surface(field, torch.stack([low - 4 * cell, high + 4 * cell]), _CELLS)
    winding = torch.cat([mesh.winding_number(chunk) for chunk in surface.vertices.split(CHUNK)])
    across = ((winding - 0.5).abs() < _HALF)[surface.simplices].all(1)
    return surface.vertices[surface.simplices[across]]
