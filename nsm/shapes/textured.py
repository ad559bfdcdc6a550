"""Meshes with colors, textures, and other attributes of vertices."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.shapes.download import resolve
from nsm.shapes.mesh_reading import read_mesh, require_finite
from nsm.shapes.reading import unreadable
from nsm.types import SimplexMesh

#: Properties of vertices in a ply file that have their own fields.
_KNOWN = {*("x", "y", "z", "nx", "ny", "nz"), *("red", "green", "blue", "alpha"), *("s", "t", "u", "v")}


class Attributes(NamedTuple):
    """Attributes of the vertices of a mesh, which advection does not change.

    Attributes:
        colors: sRGB colors in [0, 1], shape (v, 3).
        uv: Texture coordinates, shape (v, 2), with (0, 0) at the lower left of the texture.
        texture: Image that ``uv`` refers to.
        others: Other values by name, shape (v,) or (v, m).
    """

    colors: Float[Tensor, "v 3"] | None = None
    uv: Float[Tensor, "v 2"] | None = None
    texture: Image.Image | None = None
    others: Mapping[str, Tensor] = MappingProxyType({})


class TexturedMesh(NamedTuple):
    """A mesh with attributes of its vertices."""

    mesh: SimplexMesh
    attributes: Attributes = Attributes()


def load_textured(path: Path | str) -> TexturedMesh:
    """Read a mesh file with its colors, texture, and other attributes of its vertices, without changes.

    Vertices are in double precision and in the coordinates of the file; none are merged.

    Args:
        path: An obj, ply, stl, off, or glb file, or a public name such as ``meshes/spot.obj``.

    Raises:
        InputError: If there is no such file, or it is not a mesh.
    """
    file = resolve(str(path))
    read = read_mesh(file)
    require_finite(np.asarray(read.vertices), str(path))
    mesh = SimplexMesh(
        torch.tensor(np.asarray(read.vertices), dtype=torch.double), torch.tensor(np.asarray(read.faces))
    )
    try:
        attributes = _appearance(read)._replace(others=_others(read))
    except Exception as error:  # damaged colors and textures raise various exceptions
        raise unreadable(file, "a mesh with colors or a texture", error) from error
    for values in (attributes.colors, attributes.uv):
        if values is not None and (len(values) != len(mesh.vertices) or not bool(values.isfinite().all())):
            raise InputError(
                f"`{path}` must have one color or place in the texture for each of its {len(mesh.vertices)} vertices, "
                f"got {len(values)}, or some that are not finite. Try to export the mesh again."
            )
    return TexturedMesh(mesh, attributes)


def _others(read: trimesh.Trimesh) -> dict[str, Tensor]:
    """Collect numeric attributes other than positions, normals, and colors."""
    values = {str(name): np.asarray(array) for name, array in read.vertex_attributes.items()}
    # trimesh stores those of a ply file only in its raw data
    raw = read.metadata.get("_ply_raw", {}).get("vertex", {}).get("data", {})
    names = raw.dtype.names if isinstance(raw, np.ndarray) else tuple(raw)
    values |= {str(name): np.asarray(raw[name]) for name in names or () if name not in _KNOWN}
    return {
        name: torch.tensor(array.astype(array.dtype.newbyteorder("=")))
        for name, array in values.items()
        if array.dtype.kind in "fiu" and len(array) == len(read.vertices)
    }


def _appearance(read: trimesh.Trimesh) -> Attributes:
    """Read colors, or texture coordinates and the texture."""
    visual: Any = read.visual
    if visual.kind in ("vertex", "face"):
        colors = torch.tensor(np.asarray(visual.vertex_colors)[:, :3], dtype=torch.double) / 255
        return Attributes(colors=colors)
    uv = getattr(visual, "uv", None)
    if uv is None:
        return Attributes()
    material = visual.material
    texture = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    return Attributes(uv=torch.tensor(np.asarray(uv)[:, :2], dtype=torch.double), texture=texture)
