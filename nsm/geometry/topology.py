"""Counts and angles of a mesh: components, Euler number, genus, curvature, roughness, measure, normals.

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


def subdivided(mesh: SimplexMesh) -> SimplexMesh:
    """The same surface in finer pieces: triangles cut into four, segments into two, at the middles of their edges.

    The vertices of the mesh come first, so that the first v of the new ones are they.
    """
    edges = _edges(mesh.simplices)
    _, number = _edge_keys(mesh.simplices).unique(return_inverse=True)
    if not len(number):
        return mesh
    ends = edges.new_empty(int(number.max()) + 1, 2)
    ends[number] = edges
    vertices = torch.cat([mesh.vertices, mesh.vertices[ends].mean(1)])
    middles = (number + len(mesh.vertices)).view(-1, len(mesh.simplices))
    if mesh.simplices.shape[1] == 2:
        (start, end), middle = mesh.simplices.T, middles[0]
        parts = [[start, middle], [middle, end]]
    else:
        (a, b, c), (ab, bc, ca) = mesh.simplices.T, middles
        parts = [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
    return SimplexMesh(vertices, torch.cat([torch.stack(part, 1) for part in parts]))


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


def component_volumes(mesh: SimplexMesh) -> Float[Tensor, " c"]:
    """Volume (area in 2D) that each connected component encloses, in the order of `component_labels`.

    A hollow, whose surface is turned inwards, has a negative volume. Of a component that is open the volume is that of
    the cone over it from the middle of its vertices' box.
    """
    labels = component_labels(mesh)
    count = int(labels.max()) + 1 if len(labels) else 0
    corners = mesh.vertices[mesh.simplices].double()
    index = labels[:, None, None].expand(corners.shape)
    extremes = [
        corners.new_zeros(count, *corners.shape[1:]).scatter_reduce(0, index, corners, kind, include_self=False)
        for kind in ("amin", "amax")
    ]
    middle = (extremes[0].amin(1) + extremes[1].amax(1)) / 2
    arms = corners.mean(1) - middle[labels]
    cones = (arms * simplex_normals(mesh).double()).sum(1) / mesh.vertices.shape[1]
    return cones.new_zeros(count).index_add_(0, labels, cones)


def euler_number(mesh: SimplexMesh) -> int:
    """Vertices − edges + triangles of a surface, vertices − segments of a curve (0 when all its parts are closed)."""
    used = len(mesh.simplices.unique())
    if mesh.simplices.shape[1] == 2:
        return used - len(mesh.simplices)
    return used - len(_edge_keys(mesh.simplices).unique()) + len(mesh.simplices)


def genus(mesh: SimplexMesh) -> int:
    """Number of handles of a closed surface, all components together: components − Euler number / 2; 0 for a curve."""
    if mesh.simplices.shape[1] == 2:
        return 0
    return component_count(mesh) - euler_number(mesh) // 2


def total_curvatures(mesh: SimplexMesh) -> Float[Tensor, " v"]:
    """Curvature in radians that each vertex carries: how far the mesh turns there.

    In 3D the angle that is missing around the vertex, 2π − Σ angles; in 2D the angle between the segments before and
    after it, positive where the inside is convex. By Gauss and Bonnet the sum over a closed surface is 2π times its
    Euler number, and over closed curves 2π times the Euler number of their inside. Vertices on the rim of an open mesh
    carry none.
    """
    if mesh.simplices.shape[1] == 2:
        return _turning_angles(mesh)
    corners = mesh.vertices[mesh.simplices].double()
    total = corners.new_zeros(len(mesh.vertices))
    for corner in range(3):
        a, b = (corners[:, (corner + k) % 3] - corners[:, corner] for k in (1, 2))
        angles = torch.atan2(torch.linalg.cross(a, b).norm(dim=1), (a * b).sum(1))
        # a triangle with an edge of no length still has angles of π in all: a right one at each end of that edge
        angles[(a == 0).all(1) | (b == 0).all(1)] = torch.pi / 2
        total.index_add_(0, mesh.simplices[:, corner], angles)
    missing = torch.where(total > 0, 2 * torch.pi - total, 0.0)
    edges = _edges(mesh.simplices)
    _, group, count = _edge_keys(mesh.simplices).unique(return_inverse=True, return_counts=True)
    missing[edges[(count == 1)[group]].flatten()] = 0.0
    return missing.to(mesh.vertices)


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


def _turning_angles(mesh: SimplexMesh) -> Float[Tensor, " v"]:
    start, end = mesh.simplices.T
    along = (mesh.vertices[end] - mesh.vertices[start]).double()
    before, after = (torch.zeros_like(mesh.vertices, dtype=torch.double) for _ in range(2))
    before[end], after[start] = along, along
    # both are zero where a curve ends or begins, and so is atan2(0, 0)
    turned = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return torch.atan2(turned, (before * after).sum(1)).to(mesh.vertices)


def _edges(simplices: Int[Tensor, "m k"]) -> Int[Tensor, "e 2"]:
    """Edges of all simplices as sorted pairs of vertices, each simplex's own: all first edges, all second, …"""
    if simplices.shape[1] == 2:
        return simplices.sort(1).values
    return torch.cat([simplices[:, [0, 1]], simplices[:, [1, 2]], simplices[:, [2, 0]]]).sort(1).values


def _edge_keys(simplices: Int[Tensor, "m k"]) -> Int[Tensor, " e"]:
    """One number an edge, the same for the same edge; numbers sort and compare much faster than pairs."""
    edges = _edges(simplices)
    return edges[:, 0] * (int(simplices.max()) + 1 if len(simplices) else 1) + edges[:, 1]
