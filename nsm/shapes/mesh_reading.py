"""Reading of triangle meshes from files, with merged vertices and outward orientation."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, NamedTuple

import igl
import numpy as np
import torch
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from nsm.cli.errors import InputError
from nsm.geometry.sampling import sample_mesh
from nsm.shapes.reading import require_content, unreadable
from nsm.shapes.sampling import unit_normals
from nsm.shapes.surface_files import SURFACE_FORMATS, read_surface
from nsm.types import SimplexMesh

log = logging.getLogger(__name__)

#: Extensions of supported files.
FORMATS = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf", *SURFACE_FORMATS)
#: Distance below which vertices are merged, relative to the diagonal: formats split vertices at texture seams.
_MERGE_DISTANCE = 1e-7
#: Fractions of unused vertices above which an obj file counts as truncated: if its last line is incomplete, and in any
#: case. Scans may contain unused vertices (3 % in stanford-bunny.obj).
_MAX_UNUSED_VERTICES = (0.0, 0.2)
#: Largest coordinate, whose cube is far from the largest number in double precision.
_MAX_COORDINATE = 1e30
#: Minimum volume, relative to the cube of the longest side of the bounding box.
_MIN_FILL = 1e-6
#: Minimum of the mean winding number just below the surface: it is 1 for a closed mesh, 1/2 for a flat sheet, and
#: between them for a bowl.
MIN_WINDING = 0.6


class Openness(NamedTuple):
    """The deviation of a mesh from a closed surface.

    Attributes:
        edges: Number of boundary edges, which have only one triangle.
        loops: Number of loops that they form.
        gap: ‖Σ area·normal‖ / Σ area, which is 0 for a closed surface and 1 for a flat sheet.
    """

    edges: int
    loops: int
    gap: float


def read_mesh(file: Path) -> trimesh.Trimesh:
    """Read all triangles of a file as one mesh.

    Raises:
        InputError: If the extension is not supported, or the content is not a mesh.
    """
    if file.suffix.lower() not in FORMATS:
        raise InputError(f"`path` must end in {', '.join(FORMATS)}, got {file}. Try to convert the mesh to `.obj`.")
    require_content(file, "a mesh")
    try:
        mesh: Any
        if file.suffix.lower() in SURFACE_FORMATS:
            mesh = read_surface(file)
        else:
            mesh = trimesh.load(file, force="mesh", process=False)
        if file.suffix.lower() == ".obj":
            _require_all_faces(file)
    except InputError:
        raise
    except Exception as error:  # readers raise various exceptions for damaged files
        raise unreadable(file, "a mesh", error) from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0 or len(mesh.vertices) == 0:
        raise InputError(
            f"`{file}` must contain triangles, got none. Try a mesh with faces, or "
            "`shape@source=points` for a point cloud."
        )
    _require_triangles(np.asarray(mesh.vertices), np.asarray(mesh.faces), str(file))
    return mesh


def _require_triangles(vertices: np.ndarray, faces: np.ndarray, name: str) -> None:
    """Require vertices with three coordinates, and triangles of vertices that exist."""
    shapes = (vertices.shape, faces.shape)
    if any(len(shape) != 2 or shape[1] != 3 for shape in shapes):
        raise InputError(
            f"`{name}` must hold vertices with three coordinates and triangles, got arrays of shape {shapes[0]} and "
            f"{shapes[1]}. Try to export the mesh again."
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(
            f"`{name}` must contain all vertices that its faces use, got {len(vertices)} vertices. Try to export the "
            "mesh again; the file may be truncated."
        )


def require_finite(vertices: np.ndarray, name: str) -> None:
    """Require coordinates that are finite, and small enough for volumes to be.

    Raises:
        InputError: If some are not.
    """
    if bad := int((~(np.abs(vertices) < _MAX_COORDINATE)).any(1).sum()):
        raise InputError(
            f"`{name}` must have finite vertices, got {bad} that are not finite. Try to export the mesh again."
        )


def _require_all_faces(file: Path) -> None:
    """Reject a truncated obj file, in which the faces that use the vertices are missing."""
    vertices, used, line = 0, set[int](), b"\n"
    with file.open("rb") as lines:
        for line in lines:
            if line.startswith(b"v "):
                vertices += 1
            elif line.startswith(b"f "):
                indices = [int(corner.split(b"/")[0]) for corner in line.split()[1:]]
                if 0 in indices:
                    raise ValueError("a face has the vertex 0, but vertices are counted from 1")
                used.update(i if i > 0 else vertices + 1 + i for i in indices)
    ended = line.endswith(b"\n")
    if vertices - len(used) > _MAX_UNUSED_VERTICES[ended] * vertices:
        raise InputError(
            f"`{file}` must contain faces for its {vertices} vertices, got faces that use {len(used)} of them. Try to "
            "export the mesh again; the file may be truncated."
        )


def merge_vertices(mesh: trimesh.Trimesh, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Merge coincident vertices and remove degenerate triangles.

    Args:
        mesh: The mesh as read from a file.
        name: Name of the file, for messages.

    Returns:
        Vertices, shape (v, 3), and triangles, shape (m, 3).

    Raises:
        InputError: If a coordinate is not finite, or all triangles are degenerate.
    """
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    vertices, faces = _compact(vertices, faces)
    require_finite(vertices, name)
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if diagonal == 0:
        raise InputError(f"`{name}` must enclose a volume, got vertices that all coincide. Try a closed mesh.")
    cells = np.round((vertices - vertices.min(0)) / (_MERGE_DISTANCE * diagonal)).astype(np.int64)
    _, first, inverse = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[faces]
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    if not proper.any():
        raise InputError(f"`{name}` must enclose a volume, got only degenerate triangles. Try a closed mesh.")
    return _compact(vertices[first], faces[proper])


def orient_outward(vertices: np.ndarray, faces: np.ndarray, name: str) -> np.ndarray:
    """Orient triangles outward by the winding number just below them.

    Args:
        vertices: Vertices relative to the center of the mesh, shape (v, 3), because winding numbers are computed in
            single precision.
        faces: Triangles, shape (m, 3).
        name: Name of the mesh, for messages.

    Returns:
        Triangles with outward normals, shape (m, 3).

    Raises:
        InputError: If neither side is the inside, or the inside has no volume.
    """
    state = openness(vertices, faces)
    below = _winding_below(vertices, faces)
    if state.edges and max(below, 1 - below) < MIN_WINDING:
        raise InputError(
            f"`{name}` must be nearly closed, got {state.edges} boundary edges and a winding number of {below:.2f} "
            "below the surface, where 1 is closed. Try to close the holes of the mesh."
        )
    if below < 0.5:
        log.warning("%s is inside out; its triangles are flipped", name)
        faces = faces[:, ::-1].copy()
    amount = signed_volume(vertices, faces)
    if not state.edges and amount <= _MIN_FILL * float(np.ptp(vertices, axis=0).max()) ** 3:
        raise InputError(
            f"`{name}` must enclose a positive volume, got {amount:.3g}. Try a mesh with consistently "
            "oriented triangles."
        )
    return faces


def openness(vertices: np.ndarray, faces: np.ndarray) -> Openness:
    """Count boundary edges and loops, and measure how far the oriented area is from zero."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    rim = unique[count == 1]
    normals = _area_normals(vertices, faces)
    gap = float(np.linalg.norm(normals.sum(0)) / np.linalg.norm(normals, axis=1).sum())
    if not len(rim):
        return Openness(0, 0, gap)
    rim = np.unique(rim, return_inverse=True)[1].reshape(-1, 2)
    graph = coo_array((np.ones(len(rim)), (rim[:, 0], rim[:, 1])), shape=(rim.max() + 1,) * 2)
    return Openness(len(rim), int(connected_components(graph, directed=False)[0]), gap)


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Compute the volume by the divergence theorem, Σ ⟨a, b × c⟩ / 6, positive if normals point outward."""
    a, b, c = (vertices - vertices.mean(0))[faces].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _area_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return np.cross(b - a, c - a) / 2


def _winding_below(vertices: np.ndarray, faces: np.ndarray, count: int = 2000) -> float:
    """Compute the mean winding number just below points sampled by area on the triangles."""
    mesh = SimplexMesh(torch.from_numpy(vertices), torch.from_numpy(faces))
    points, chosen = sample_mesh(mesh, count, torch.Generator().manual_seed(0))
    normals = unit_normals(mesh.vertices[mesh.simplices[chosen]])
    offset = 1e-6 * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    return float(igl.fast_winding_number(vertices, faces, (points - offset * normals).numpy()).mean())


def _compact(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Remove vertices that no triangle uses."""
    used, faces = np.unique(faces, return_inverse=True)
    return np.ascontiguousarray(vertices[used]), np.ascontiguousarray(faces.reshape(-1, 3).astype(np.int64))
