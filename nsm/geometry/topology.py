"""Counts and angles of a mesh: components, Euler number, genus, roughness, measure, normals.

Everything takes a `SimplexMesh`, triangles in 3D or segments in 2D; a mesh of no simplices has no components, Euler
number 0, measure 0 and roughness 0.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from nsm.types import SimplexMesh


def simplex_normals(mesh: SimplexMesh) -> Float[Tensor, "m d"]:
    """Outward normals (m, d) whose length is the measure of each simplex (area, or length in 2D)."""
    corners = mesh.vertices[mesh.simplices]
    if mesh.vertices.shape[1] == 2:
        along = corners[:, 1] - corners[:, 0]
        return torch.stack([along[:, 1], -along[:, 0]], 1)
    return torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


def vertex_normals(mesh: SimplexMesh) -> Float[Tensor, "v d"]:
    """Unit normals (v, d): at each vertex the mean over its simplices, weighted by measure."""
    normals = simplex_normals(mesh)
    total = torch.zeros_like(mesh.vertices)
    for corner in mesh.simplices.T:
        total.index_add_(0, corner, normals)
    return torch.nn.functional.normalize(total, dim=1)


def measure(mesh: SimplexMesh) -> float:
    """Area of a surface, length of a curve."""
    return float(simplex_normals(mesh).norm(dim=1).sum())


def enclosed_volume(mesh: SimplexMesh) -> float:
    """Volume (3D) or area (2D) inside a closed mesh, ∫ x·n / d; negative where it is turned inside out."""
    middle = mesh.vertices[mesh.simplices].mean(1)
    return float((middle * simplex_normals(mesh)).sum() / mesh.vertices.shape[1])


def component_labels(mesh: SimplexMesh) -> Int[Tensor, " m"]:
    """Number of the connected component, 0, 1, …, that each simplex belongs to."""
    if not len(mesh.simplices):
        return mesh.simplices.new_zeros(0)
    edges = _edges(mesh.simplices).cpu().numpy()
    size = len(mesh.vertices)
    graph = coo_matrix((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(size, size))
    label = connected_components(graph, directed=False)[1][mesh.simplices[:, 0].cpu().numpy()]
    return torch.as_tensor(np.unique(label, return_inverse=True)[1], device=mesh.simplices.device)


def component_count(mesh: SimplexMesh) -> int:
    """Number of connected components; vertices that no simplex uses do not count."""
    labels = component_labels(mesh)
    return int(labels.max()) + 1 if len(labels) else 0


def component_measures(mesh: SimplexMesh) -> Float[Tensor, " c"]:
    """Area (length in 2D) of each connected component, largest first."""
    labels = component_labels(mesh)
    sizes = simplex_normals(mesh).norm(dim=1)
    total = sizes.new_zeros(int(labels.max()) + 1 if len(labels) else 0)
    return total.index_add_(0, labels, sizes).sort(descending=True).values


def euler_number(mesh: SimplexMesh) -> int:
    """Vertices − edges + triangles of a surface, vertices − segments of a curve (0 when all its parts are closed)."""
    used = len(mesh.simplices.unique())
    if mesh.simplices.shape[1] == 2:
        return used - len(mesh.simplices)
    return used - len(_edge_keys(mesh.simplices).unique()) + len(mesh.simplices)


def genus(mesh: SimplexMesh) -> int:
    """Number of handles of a closed surface, all components together: components − Euler number / 2."""
    return component_count(mesh) - euler_number(mesh) // 2


def mean_dihedral_angle(mesh: SimplexMesh) -> float:
    """Roughness: mean angle in degrees between the normals of neighbouring simplices.

    Neighbours share an edge (3D) or a vertex (2D), and every pair counts the same. On a smooth surface the angle is
    proportional to the size of the simplices; so compare meshes of one resolution only. Simplices of zero measure
    have no normal and are passed over.
    """
    shared = _edge_keys(mesh.simplices) if mesh.simplices.shape[1] == 3 else mesh.simplices.T.flatten()
    owner = torch.arange(len(mesh.simplices), device=shared.device).repeat(mesh.simplices.shape[1])
    _, group, count = shared.unique(return_inverse=True, return_counts=True)
    order = group.argsort()
    pairs = owner[order[(count == 2)[group[order]]]].view(-1, 2)
    normals = simplex_normals(mesh).double()
    size = normals.norm(dim=1)
    pairs = pairs[(size[pairs] > 1e-6 * size.mean()).all(1)]
    if not len(pairs):
        return 0.0
    unit = normals / size[:, None]
    a, b = unit[pairs[:, 0]], unit[pairs[:, 1]]
    # 2 atan2(|a - b|, |a + b|) keeps small angles exact, where acos loses half of the digits
    return float(torch.rad2deg(2 * torch.atan2((a - b).norm(dim=1), (a + b).norm(dim=1))).mean())


def _edges(simplices: Int[Tensor, "m k"]) -> Int[Tensor, "e 2"]:
    """Edges of all simplices as sorted pairs of vertices, each simplex's own: all first edges, all second, …"""
    if simplices.shape[1] == 2:
        return simplices.sort(1).values
    return torch.cat([simplices[:, [0, 1]], simplices[:, [1, 2]], simplices[:, [2, 0]]]).sort(1).values


def _edge_keys(simplices: Int[Tensor, "m k"]) -> Int[Tensor, " e"]:
    """One number an edge, the same for the same edge; numbers sort and compare much faster than pairs."""
    edges = _edges(simplices)
    return edges[:, 0] * (int(simplices.max()) + 1 if len(simplices) else 1) + edges[:, 1]
