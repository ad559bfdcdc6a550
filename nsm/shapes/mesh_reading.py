"""Triangle meshes read from files, welded and turned outwards."""

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
from nsm.shapes.sampling import sample_mesh_surface, simplex_normals
from nsm.shapes.surface_files import SURFACE_FORMATS, read_surface
from nsm.types import SimplexMesh

log = logging.getLogger(__name__)

#: Endings of files that can be read.
FORMATS = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf", *SURFACE_FORMATS)
#: Vertices closer than this part of the diagonal are one: those that a format splits at UV seams or normals.
WELD = 1e-7
#: Parts of the vertices of an obj file that belong to no face from which it passes for cut short: if its last line
#: has no end, and in any case. (Scans may hold loose vertices: stanford-bunny.obj has 3 %.)
UNUSED_VERTICES = (0.0, 0.2)
#: An inside must fill at least this part of the bounding box.
LEAST_FILL = 1e-6
#: Mean winding number just beneath the surface: 1 for a closed mesh, 1/2 for a flat sheet, between them for a bowl.
LEAST_WINDING = 0.6


class Openness(NamedTuple):
    """How far a mesh is from closed."""

    #: Edges with one triangle, and the loops that they form.
    edges: int
    loops: int
    #: |Σ area·normal| / Σ area, which is 0 for a closed surface and 1 for a flat sheet.
    gap: float


def read_mesh(file: Path) -> trimesh.Trimesh:
    """All triangles of a file as one mesh.

    Raises:
        InputError: if the ending is unknown, or the content is no mesh.
    """
    if file.suffix.lower() not in FORMATS:
        raise InputError(f"{file} ends in '{file.suffix}': give a mesh file that ends in {', '.join(FORMATS)}.")
    if file.stat().st_size == 0:
        raise InputError(f"{file} is empty: give a mesh file with triangles in it.")
    try:
        mesh: Any
        if file.suffix.lower() in SURFACE_FORMATS:
            mesh = read_surface(file)
        else:
            mesh = trimesh.load(file, force="mesh", process=False)
    except InputError:
        raise
    except Exception as error:  # readers of damaged files raise anything, and all of it means one thing
        raise InputError(
            f"{file} cannot be read as a mesh ({type(error).__name__}: {str(error)[:80]}): it may be cut short or of "
            "another format, so export it again."
        ) from error
    if file.suffix.lower() == ".obj":
        _require_all_faces(file)
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0 or len(mesh.vertices) == 0:
        raise InputError(
            f"{file} holds no triangles: give a mesh with faces (for points with normals use shape=points)."
        )
    return mesh


def _require_all_faces(file: Path) -> None:
    """Raise an `InputError` for an obj file that was cut: most vertices come before the faces that name them."""
    vertices, named, line = 0, set[int](), b"\n"
    with file.open("rb") as lines:
        for line in lines:
            if line.startswith(b"v "):
                vertices += 1
            elif line.startswith(b"f "):
                indices = [int(corner.split(b"/")[0] or 0) for corner in line.split()[1:]]
                named.update(i if i > 0 else vertices + 1 + i for i in indices)
    ended = line.endswith(b"\n")
    if vertices - len(named) > UNUSED_VERTICES[ended] * vertices:
        raise InputError(
            f"The faces of {file} use {len(named)} of its {vertices} vertices, so it was cut short: export it again."
        )


def welded(mesh: trimesh.Trimesh, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 3) and triangles (m, 3), with coinciding vertices merged and triangles that collapse dropped.

    Raises:
        InputError: for coordinates that are not finite, indices without a vertex, or a mesh of one point.
    """
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"{name} names vertices that it does not hold: it is cut short, so export it again.")
    vertices, faces = _compact(vertices, faces)
    if bad := int((~np.isfinite(vertices)).any(1).sum()):
        raise InputError(f"{name} has {bad} vertices that are not finite numbers: repair or export the mesh again.")
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if diagonal == 0:
        raise InputError(f"All vertices of {name} are one point, so it has no volume: give a mesh with an inside.")
    cells = np.round((vertices - vertices.min(0)) / (WELD * diagonal)).astype(np.int64)
    _, first, inverse = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[faces]
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    if not proper.any():
        raise InputError(f"All triangles of {name} have collapsed, so it has no volume: give a mesh with an inside.")
    return _compact(vertices[first], faces[proper])


def turned_outwards(vertices: np.ndarray, faces: np.ndarray, name: str) -> np.ndarray:
    """The same triangles with their normals outwards, by the winding number just beneath them.

    Args:
        vertices: relative to the center of the mesh: winding numbers are found in single precision.
        faces: the triangles.
        name: of the mesh, for messages.

    Raises:
        InputError: if no side is the inside, or the inside has no volume.
    """
    state = openness(vertices, faces)
    beneath = _winding_beneath(vertices, faces)
    if state.edges and max(beneath, 1 - beneath) < LEAST_WINDING:
        raise InputError(
            f"{name} is so open that it has no inside ({state.edges} boundary edges; the winding number is "
            f"{beneath:.2f} on one side and that less 1 on the other): give a closed mesh, or close its holes."
        )
    if beneath < 0.5:
        log.warning("%s is inside out: its triangles are turned", name)
        faces = faces[:, ::-1].copy()
    amount = signed_volume(vertices, faces)
    if not state.edges and amount <= LEAST_FILL * float(np.ptp(vertices, axis=0).max()) ** 3:
        raise InputError(f"{name} has volume {amount:.3g}: give a mesh with an inside, whose normals point one way.")
    return faces


def openness(vertices: np.ndarray, faces: np.ndarray) -> Openness:
    """Count the boundary and measure how far the oriented area is from closing."""
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
    """Volume by the divergence theorem, Σ ⟨a, b × c⟩ / 6 about the mean vertex, positive if normals point out."""
    a, b, c = (vertices - vertices.mean(0))[faces].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _area_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return np.cross(b - a, c - a) / 2


def _winding_beneath(vertices: np.ndarray, faces: np.ndarray, count: int = 2000) -> float:
    """Mean winding number a hair beneath points drawn on the triangles by area."""
    mesh = SimplexMesh(torch.from_numpy(vertices), torch.from_numpy(faces))
    points, chosen = sample_mesh_surface(mesh, count, torch.Generator().manual_seed(0))
    normals = simplex_normals(mesh.vertices[mesh.simplices[chosen]])
    hair = 1e-6 * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    return float(igl.fast_winding_number(vertices, faces, (points - hair * normals).numpy()).mean())


def _compact(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same triangles without the vertices that none of them uses."""
    used, faces = np.unique(faces, return_inverse=True)
    return np.ascontiguousarray(vertices[used]), np.ascontiguousarray(faces.reshape(-1, 3).astype(np.int64))
