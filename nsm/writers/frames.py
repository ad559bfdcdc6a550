"""The surface of a morph at one time, as a mesh and as a file."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from nsm.geometry.meshing import extract_surface
from nsm.types import Morph, SimplexMesh
from nsm.writers.mesh import write_mesh


@torch.no_grad()
def extract_frame(morph: Morph, time: float, resolution: int) -> tuple[SimplexMesh, Float[Tensor, "v d"]]:
    """The surface at one time on ``resolution``^d cells of ``morph.bounds``, and its normals ∇f/‖∇f‖ (v, d)."""
    mesh = extract_surface(partial(morph, t=time), morph.bounds, resolution)
    return mesh, normalize(morph.gradient(mesh.vertices, time), dim=1)


def save_frame(morph: Morph, time: float, file: Path, resolution: int) -> SimplexMesh:
    """Extract the surface of a morph at one time and write it with the normals ∇f/‖∇f‖."""
    mesh, normals = extract_frame(morph, time, resolution)
    write_mesh(file, mesh, normals)
    return mesh
