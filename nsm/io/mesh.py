"""Meshes as files."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.cli.files import whole_file
from nsm.geometry.topology import vertex_normals
from nsm.shapes.textured import Attributes
from nsm.types import SimplexMesh

NO_ATTRIBUTES = Attributes()

#: Rounding of coordinates, in parts of the size of the mesh, that is written in single precision all the same.
_ROUNDING = 1e-6
#: Names of numbers in a ply file, and of the same in numpy.
_PLY_TYPES = {np.float32: ("float", "<f4"), np.float64: ("double", "<f8")}


def write_mesh(
    path: Path | str,
    mesh: SimplexMesh,
    normals: Float[Tensor, "v d"] | None = None,
    attributes: Attributes = NO_ATTRIBUTES,
) -> None:
    """Write a surface as PLY (binary), OBJ or STL (binary), by the suffix of ``path``; a 2D curve as OBJ lines.

    PLY and OBJ carry vertex normals, colors (sRGB) and texture coordinates. A curve lies in the plane z = 0. A surface
    that is not there gives a valid file without triangles, so that a sequence has no gaps. Where single precision would
    show, for a small shape far from the origin, PLY and OBJ have coordinates in double precision.

    Args:
        path: where to write; folders are made.
        mesh: what to write.
        normals: unit normals at the vertices (v, d); means of the simplices' by default.
        attributes: of the vertices; their texture is left out, and all of them in STL.

    Raises:
        InputError: if the suffix is none of the three, or not .obj for a curve, or the file cannot be written.
    """
    path = Path(path)
    dim = mesh.vertices.shape[1]
    encoders = {".obj": _obj} if dim == 2 else {".ply": _ply, ".obj": _obj, ".stl": _stl}
    if path.suffix.lower() not in encoders:
        raise InputError(f"{path.name} names no format for a mesh in {dim}D: let it end in {' or '.join(encoders)}")
    normals = vertex_normals(mesh) if normals is None else normals
    arrays = (_places(mesh.vertices), mesh.simplices.cpu().numpy(), _in_space(normals))
    data = encoders[path.suffix.lower()](*arrays, _extra(attributes))
    with whole_file(path) as temporary:
        temporary.write_bytes(data)


class _Extra(NamedTuple):
    """Colors (v, 3) in 0..1 and texture coordinates (v, 2), where there are any."""

    colors: np.ndarray | None
    uv: np.ndarray | None


def _extra(attributes: Attributes) -> _Extra:
    colors, uv = (None if v is None else v.detach().cpu().numpy() for v in (attributes.colors, attributes.uv))
    return _Extra(colors, uv)


def _places(vertices: Tensor) -> np.ndarray:
    """Vertices (v, 3) in single precision, or in double where rounding would show: far from the origin of a file."""
    single, double = _in_space(vertices), _in_space(vertices, np.float64)
    if not len(double) or np.abs(single - double).max() <= _ROUNDING * np.ptp(double, axis=0).max():
        return single
    return double


def _in_space(vectors: Tensor, dtype: type = np.float32) -> np.ndarray:
    """Vectors (v, 3); those of the plane get z = 0."""
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
    # colors stand behind the coordinates, which is no part of the format but widely read
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
