"""The surface of the solid that a mesh with holes, or of parts that overlap, stands for."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from nsm.geometry.grid import CHUNK
from nsm.geometry.meshing import extract_surface
from nsm.geometry.triangles import Triangles

#: Cells along the longest side of the mesh: by them holes are closed and triangles are cut where parts overlap.
_CELLS = 128
#: How far beside a triangle the winding number is looked at, in parts of the size of the mesh.
_HAIR = 1e-5
#: Where each triangle is looked at: near its corners and in the middle, by weights of its corners.
_PLACES = torch.tensor([[0.9, 0.05, 0.05], [0.05, 0.9, 0.05], [0.05, 0.05, 0.9], [1 / 3, 1 / 3, 1 / 3]])
#: Triangles with longer edges than so many cells are cut before they are looked at, if not all of them is exposed.
_COARSE = 4
#: The closing of a hole is where the winding number is this close to 1/2. At a triangle it jumps from 0 to 1.
_HALF = 0.2
#: The winding number is turned into a length by this many cells: close to triangles it is then no less than distance.
_STEEP = 8


def solid_boundary(vertices: np.ndarray, faces: np.ndarray, is_open: bool) -> tuple[np.ndarray, np.ndarray]:
    """Triangles around the set where the winding number of a mesh is above 1/2.

    Those parts of its triangles that have the inside on both sides, or on none, are left out, so that distances are
    those to the surface of the solid. Holes are closed where the winding number is 1/2.

    Args:
        vertices: (v, 3), double precision.
        faces: triangles (m, 3), turned outwards.
        is_open: whether there may be holes.

    Returns:
        The same for the boundary; the very same arrays where nothing is to be done.
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
    """Corners (k, 3, 3) of the triangles with the inside just below and the outside just above, cut where need be."""
    whole = torch.arange(len(corners))  # of which triangle each part is
    parts, kept, owners = corners, [corners[:0]], [whole[:0]]
    intact = torch.ones(len(corners), dtype=torch.bool)
    size = _COARSE * cell
    while len(parts):
        seen = _exposed(mesh, parts)
        longest = (parts - parts.roll(1, 1)).norm(dim=2).amax(1)
        mixed = seen.any(1) & ~seen.all(1)
        cut = (mixed & (longest > cell)) | (~seen.all(1) & (longest > size))
        keep = torch.where(mixed, seen[:, 3], seen.all(1)) & ~cut
        intact[whole[~keep & ~cut]] = False
        kept.append(parts[keep])
        owners.append(whole[keep])
        whole = whole[cut].repeat(4)
        parts = _quartered(parts[cut])
    pieces, owner = torch.cat(kept), torch.cat(owners)
    return torch.cat([corners[intact], pieces[~intact[owner]]])


def _exposed(mesh: Triangles, corners: Tensor) -> Tensor:
    """Whether the inside is just below and the outside just above, at the places (n, 4) of triangles."""
    normals = nn.functional.normalize(torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    hair = _HAIR * float(np.ptp(mesh.vertices, axis=0).max()) * normals[:, None]
    at = torch.einsum("pk,nkd->npd", _PLACES.to(corners), corners)
    above, below = (mesh.winding_number(side.reshape(-1, 3)).view(len(corners), -1) for side in (at + hair, at - hair))
    return (above <= 0.5) & (below > 0.5)


def _quartered(corners: Tensor) -> Tensor:
    """Triangles cut into four at the middles of their edges."""
    a, b, c = corners.unbind(1)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return torch.cat([torch.stack(quarter, 1) for quarter in quarters])


def _closings(mesh: Triangles, cell: float) -> Tensor:
    """Corners (k, 3, 3) of triangles across the holes, where the winding number is 1/2."""

    def field(x: Tensor) -> Tensor:
        winding = mesh.winding_number(x) - 0.5
        away = (_STEEP * cell * winding.abs()).minimum(mesh.closest(x).distances)
        return torch.where(winding > 0, -away, away)

    low, high = torch.from_numpy(mesh.vertices.min(0)), torch.from_numpy(mesh.vertices.max(0))
    surface = extract_surface(field, torch.stack([low - 4 * cell, high + 4 * cell]), _CELLS)
    winding = torch.cat([mesh.winding_number(chunk) for chunk in surface.vertices.split(CHUNK)])
    across = ((winding - 0.5).abs() < _HALF)[surface.simplices].all(1)
    return surface.vertices[surface.simplices[across]]
