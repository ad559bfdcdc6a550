"""Meshes with what their vertices have: colors, a texture, further values."""

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

from nsm.shapes.download import resolve
from nsm.shapes.mesh_reading import read_mesh
from nsm.types import SimplexMesh

#: Values of a vertex in a ply file that are read as what they mean.
_KNOWN = {*("x", "y", "z", "nx", "ny", "nz"), *("red", "green", "blue", "alpha"), *("s", "t", "u", "v")}


class Attributes(NamedTuple):
    """What the vertices of a mesh have besides a place; nothing of it changes when they are carried.

    Attributes:
        colors: sRGB (v, 3) in 0..1.
        uv: texture coordinates (v, 2), (0, 0) at the lower left of the picture.
        texture: the picture that ``uv`` points into.
        others: further values, by name, (v,) or (v, m).
    """

    colors: Float[Tensor, "v 3"] | None = None
    uv: Float[Tensor, "v 2"] | None = None
    texture: Image.Image | None = None
    others: Mapping[str, Tensor] = MappingProxyType({})


class TexturedMesh(NamedTuple):
    """A mesh with what its vertices have."""

    mesh: SimplexMesh
    attributes: Attributes = Attributes()


def load_textured(path: Path | str) -> TexturedMesh:
    """Read a mesh file with its colors, texture and other values of its vertices, as they stand in the file.

    Nothing is merged, moved or turned; vertices are (v, 3) in double precision, in the coordinates of the file.

    Args:
        path: an obj, ply, stl, off or glb file, or a public name such as ``meshes/spot.obj``.

    Raises:
        InputError: if there is no such file, or it is no mesh.
    """
    read = read_mesh(resolve(str(path)))
    mesh = SimplexMesh(
        torch.tensor(np.asarray(read.vertices), dtype=torch.double), torch.tensor(np.asarray(read.faces))
    )
    return TexturedMesh(mesh, _look(read)._replace(others=_others(read)))


def _others(read: trimesh.Trimesh) -> dict[str, Tensor]:
    """Numbers at the vertices that are neither place, normal nor color."""
    values = {str(name): np.asarray(array) for name, array in read.vertex_attributes.items()}
    # trimesh keeps those of a ply file only as they were read
    raw = read.metadata.get("_ply_raw", {}).get("vertex", {}).get("data", {})
    names = raw.dtype.names if isinstance(raw, np.ndarray) else tuple(raw)
    values |= {str(name): np.asarray(raw[name]) for name in names or () if name not in _KNOWN}
    return {
        name: torch.tensor(array.astype(array.dtype.newbyteorder("=")))
        for name, array in values.items()
        if array.dtype.kind in "fiu" and len(array) == len(read.vertices)
    }


def _look(read: trimesh.Trimesh) -> Attributes:
    """Colors, or texture coordinates and the picture."""
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
