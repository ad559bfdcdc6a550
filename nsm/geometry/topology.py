"""Properties of a mesh: normals, area, volume, components, Euler number, genus, and curvature.

All functions take a `SimplexMesh`, triangles in 3D or segments in 2D. An empty mesh has no components, and its Euler
number, area, and roughness are 0.
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
    """Compute outward normals, shape (m, d), whose length is the area of each simplex (its length in 2D)."""
    corners = mesh.vertices[mesh.simplices]
    if mesh.vertices.shape[1] == 2:
        along = corners[:, 1] - corners[:, 0]
        return torch.stack([along[:, 1], -along[:, 0]], 1)
    return torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


def simplex_areas(corners: Float[Tensor, "m k d"]) -> Float[Tensor, " m"]:
    """Compute the areas (lengths in 2D) of simplices with corners of shape (m, d, d)."""
    edges = corners[:, 1:] - corners[:, :1]
    gram = edges @ edges.transpose(1, 2)
    return gram.det().clamp_(min=0).sqrt() / (1 if edges.shape[1] == 1 else 2)


def vertex_normals(mesh: SimplexMesh) -> Float[Tensor, "v d"]:
    """Compute unit normals at vertices, shape (v, d), as means over their simplices weighted by area."""
    normals = simplex_normals(mesh)
    total = torch.zeros_like(mesh.vertices)
    for corner in mesh.simplices.T:
        total.index_add_(0, corner, normals)
    return torch.nn.functional.normalize(total, dim=1)


def measure(mesh: SimplexMesh) -> float:
    """Compute the area of a surface, or the length of a curve."""
    return float(simplex_normals(mesh).norm(dim=1).sum())


def enclosed_volume(mesh: SimplexMesh) -> float:
    """Compute the volume inside a closed mesh (area in 2D), ∫ x·n / d; negative if the mesh is inside out."""
    middle = mesh.vertices[mesh.simplices].mean(1)
    return float((middle * simplex_normals(mesh)).sum() / mesh.vertices.shape[1])


def component_labels(mesh: SimplexMesh) -> Int[Tensor, " m"]:
    """Label each simplex with the number of its connected component, 0, 1, …, shape (m,)."""
    if not len(mesh.simplices):
        return mesh.simplices.new_zeros(0)
    edges = _edges(mesh.simplices).cpu().numpy()
    size = len(mesh.vertices)
    graph = coo_matrix((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(size, size))
    label = connected_components(graph, directed=False)[1][mesh.simplices[:, 0].cpu().numpy()]
    return torch.as_tensor(np.unique(label, return_inverse=True)[1], device=mesh.simplices.device)


def component_count(mesh: SimplexMesh) -> int:
    """Count the connected components, ignoring vertices that no simplex uses."""
    labels = component_labels(mesh)
    return int(labels.max()) + 1 if len(labels) else 0


def component_measures(mesh: SimplexMesh) -> Float[Tensor, " c"]:
    """Compute the area of each connected component (length in 2D), largest first."""
    labels = component_labels(mesh)
    sizes = simplex_normals(mesh).norm(dim=1)
    total = sizes.new_zeros(int(labels.max()) + 1 if len(labels) else 0)
    return total.index_add_(0, labels, sizes).sort(descending=True).values


def component_volumes(mesh: SimplexMesh) -> Float[Tensor, " c"]:
    """Compute the volume that each connected component encloses (area in 2D), in the order of `component_labels`.

    The surface of a cavity is oriented inward and has a negative volume. For an open component the result is the volume
    of the cone over it, whose apex is the center of its bounding box.
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
    """Compute vertices − edges + triangles of a surface, or vertices − segments of a curve (0 if all are closed)."""
    used = len(mesh.simplices.unique())
    if mesh.simplices.shape[1] == 2:
        return used - len(mesh.simplices)
    return used - len(_edge_keys(mesh.simplices).unique()) + len(mesh.simplices)


def genus(mesh: SimplexMesh) -> int:
    """Compute the genus of a closed surface, summed over components: components − Euler number / 2; 0 for a curve."""
    if mesh.simplices.shape[1] == 2:
        return 0
    return component_count(mesh) - euler_number(mesh) // 2


def total_curvatures(mesh: SimplexMesh) -> Float[Tensor, " v"]:
    """Compute the integrated curvature at each vertex, in radians, shape (v,).

    In 3D this is the angle defect 2π − Σ angles; in 2D it is the angle between successive segments, positive where the
    inside is convex. By the Gauss-Bonnet theorem it sums to 2π times the Euler number of a closed surface, or of the
    inside of closed curves. It is 0 at boundary vertices of an open mesh.
    """
    if mesh.simplices.shape[1] == 2:
        return _turning_angles(mesh)
    corners = mesh.vertices[mesh.simplices].double()
    total = corners.new_zeros(len(mesh.vertices))
    for corner in range(3):
        a, b = (corners[:, (corner + k) % 3] - corners[:, corner] for k in (1, 2))
        angles = torch.atan2(torch.linalg.cross(a, b).norm(dim=1), (a * b).sum(1))
        # the angles of a triangle with an edge of length 0 still sum to π: assign π/2 at both ends of that edge
        angles[(a == 0).all(1) | (b == 0).all(1)] = torch.pi / 2
        total.index_add_(0, mesh.simplices[:, corner], angles)
    missing = torch.where(total > 0, 2 * torch.pi - total, 0.0)
    edges = _edges(mesh.simplices)
    _, group, count = _edge_keys(mesh.simplices).unique(return_inverse=True, return_counts=True)
    missing[edges[(count == 1)[group]].flatten()] = 0.0
    return missing.to(mesh.vertices)


def mean_dihedral_angle(mesh: SimplexMesh) -> float:
    """Compute the roughness of a mesh: the mean angle between normals of neighboring simplices, in degrees.

    Neighbors share an edge (3D) or a vertex (2D), and all have equal weight. On a smooth surface the angle is
    proportional to the size of the simplices, so only compare meshes of the same resolution. Simplices of zero area
    have no normal and are ignored.
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
    # unlike acos, 2 atan2(|a − b|, |a + b|) is accurate for small angles
    return float(torch.rad2deg(2 * torch.atan2((a - b).norm(dim=1), (a + b).norm(dim=1))).mean())


def _turning_angles(mesh: SimplexMesh) -> Float[Tensor, " v"]:
    start, end = mesh.simplices.T
    along = (mesh.vertices[end] - mesh.vertices[start]).double()
    before, after = (torch.zeros_like(mesh.vertices, dtype=torch.double) for _ in range(2))
    before[end], after[start] = along, along
    # at the ends of an open curve both arguments are zero, and so is atan2(0, 0)
    turned = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return torch.atan2(turned, (before * after).sum(1)).to(mesh.vertices)


def _edges(simplices: Int[Tensor, "m k"]) -> Int[Tensor, "e 2"]:
    """List the edges of all simplices as sorted vertex indices, shape (e, 2): all first edges, then all second, …"""
    if simplices.shape[1] == 2:
        return simplices.sort(1).values
    return torch.cat([simplices[:, [0, 1]], simplices[:, [1, 2]], simplices[:, [2, 0]]]).sort(1).values


def _edge_keys(simplices: Int[Tensor, "m k"]) -> Int[Tensor, " e"]:
    """Encode each edge as one integer, because integers sort and compare much faster than rows."""
    edges = _edges(simplices)
    return edges[:, 0] * (int(simplices.max()) + 1 if len(simplices) else 1) + edges[:, 1]
