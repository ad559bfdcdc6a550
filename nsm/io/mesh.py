"""Mesh files: PLY, OBJ, and STL."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.geometry.topology import vertex_normals
from nsm.shapes.textured import Attributes
from nsm.types import SimplexMesh

NO_ATTRIBUTES = Attributes()

#: Rounding error of coordinates, relative to the size of the mesh, up to which single precision suffices.
_ROUNDING = 1e-6
#: Names of number types in a PLY file and in numpy.
_PLY_TYPES = {np.float32: ("float", "<f4"), np.float64: ("double", "<f8")}


def write_mesh(
    path: Path | str,
    mesh: SimplexMesh,
    normals: Float[Tensor, "v d"] | None = None,
    attributes: Attributes = NO_ATTRIBUTES,
) -> None:
    """Write a surface as binary PLY, OBJ, or binary STL, by the suffix of ``path``; a 2D curve as lines of an OBJ.

    PLY and OBJ carry vertex normals, colors (sRGB), and texture coordinates. A curve lies in the plane z = 0. A mesh
    without simplices gives a valid file without faces. PLY and OBJ store coordinates in double precision if rounding
    would be visible, as for a small shape far from the origin.

    Args:
        path: The file to write; missing folders are created.
        mesh: The mesh.
        normals: Unit normals at the vertices; by default means over the adjacent simplices, weighted by measure.
        attributes: Attributes of the vertices; PLY and OBJ omit the texture itself, STL omits all of them.

    Raises:
        InputError: If the suffix is unknown, or not .obj for a curve, or the file cannot be written.

    >>> import tempfile, torch
    >>> triangle = SimplexMesh(torch.eye(3), torch.tensor([[0, 1, 2]]))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_mesh(Path(folder) / "triangle.obj", triangle)
    ...     print((Path(folder) / "triangle.obj").read_text().splitlines()[0])
    v 1 0 0
    """
    path = Path(path)
    dim = mesh.vertices.shape[1]
    encoders = {".obj": _obj} if dim == 2 else {".ply": _ply, ".obj": _obj, ".stl": _stl}
    if path.suffix.lower() not in encoders:
        raise InputError(
            f"The name of a mesh file in {dim}D must end in {' or '.join(encoders)}, got {path.name}. Try "
            f"`{path.with_suffix(next(iter(encoders))).name}`."
        )
    normals = vertex_normals(mesh) if normals is None else normals
    arrays = (_places(mesh.vertices), mesh.simplices.cpu().numpy(), _in_space(normals))
    data = encoders[path.suffix.lower()](*arrays, _extra(attributes))
    with atomic_write(path) as temporary:
        temporary.write_bytes(data)


class _Extra(NamedTuple):
    """Colors (v, 3) in 0..1 and texture coordinates (v, 2), or None."""

    colors: np.ndarray | None
    uv: np.ndarray | None


def _extra(attributes: Attributes) -> _Extra:
    colors, uv = (None if v is None else v.detach().cpu().numpy() for v in (attributes.colors, attributes.uv))
    return _Extra(colors, uv)


def _places(vertices: Tensor) -> np.ndarray:
    """Vertices (v, 3) in single precision, or in double precision if the rounding error would be visible."""
    single, double = _in_space(vertices), _in_space(vertices, np.float64)
    if not len(double) or np.abs(single - double).max() <= _ROUNDING * np.ptp(double, axis=0).max():
        return single
    return double


def _in_space(vectors: Tensor, dtype: type = np.float32) -> np.ndarray:
    """Vectors (v, 3); in 2D with z = 0."""
    flat: np.ndarray = vectors.detach().cpu().numpy().astype(dtype)
    return np.pad(flat, ((0, 0), (0, 3 - flat.shape[1])))


def _ply(vertices: np.ndarray, simplices: np.ndarray, normals: np.ndarray, extra: _Extra) -> bytes:
    columns: list[tuple[str, str, str, np.ndarray]] = [
        (name, *_PLY_TYPES[block.dtype.type if block is vertices else np.float32], values)
        for names, block in (("x y z", vertices), ("nx ny nz", normals), ("s t", extra.uv))
        if block is not None
        for name, values in zip(names.split(), block.T, strict=True)
    ]
    if extra.colors is not None:
        levels = np.rint(255 * extra.colors.clip(0, 1))
        columns += [(n, "uchar", "u1", v) for n, v in zip(("red", "green", "blue"), levels.T, strict=True)]
    points = np.empty(len(vertices), dtype=[(name, kind) for name, _, kind, _ in columns])
    for name, _, _, values in columns:
        points[name] = values
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property {kind} {name}" for name, kind, _, _ in columns]
    header += [f"element face {len(simplices)}", "property list uchar int vertex_indices", "end_header", ""]
    faces = np.empty(len(simplices), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, simplices
    return "\n".join(header).encode() + points.tobytes() + faces.tobytes()


def _stl(vertices: np.ndarray, simplices: np.ndarray, normals: np.ndarray, extra: _Extra) -> bytes:
    corners = vertices[simplices]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing /= np.linalg.norm(facing, axis=1, keepdims=True).clip(np.finfo(np.float32).tiny)
    faces = np.zeros(len(simplices), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    faces["normal"], faces["corners"] = facing, corners
    return bytes(80) + np.uint32(len(simplices)).astype("<u4").tobytes() + faces.tobytes()


def _obj(vertices: np.ndarray, simplices: np.ndarray, normals: np.ndarray, extra: _Extra) -> bytes:
    # colors follow the coordinates, which is not part of the format but widely supported
    behind = [""] * len(vertices)
    if extra.colors is not None:
        behind = [f" {r:.4g} {g:.4g} {b:.4g}" for r, g, b in extra.colors.tolist()]
    digits = 9 if vertices.dtype == np.float32 else 17
    places = [" ".join(f"{value:.{digits}g}" for value in place) for place in vertices.tolist()]
    lines = [f"v {place}{more}" for place, more in zip(places, behind, strict=True)]
    if simplices.shape[1] == 2:
        lines += [f"l {a} {b}" for a, b in (simplices + 1).tolist()]
        return ("\n".join(lines) + "\n").encode()
    if extra.uv is not None:
        lines += [f"vt {u:.9g} {v:.9g}" for u, v in extra.uv.tolist()]
    lines += [f"vn {x:.6g} {y:.6g} {z:.6g}" for x, y, z in normals.tolist()]
    corner = "{0}//{0}" if extra.uv is None else "{0}/{0}/{0}"
    lines += ["f " + " ".join(corner.format(i) for i in face) for face in (simplices + 1).tolist()]
    return ("\n".join(lines) + "\n").encode()
