"""The surface of a morph at one time: what is exported, drawn and viewed."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from nsm.geometry.meshing import extract_surface
from nsm.types import Morph, SimplexMesh


class Frame(NamedTuple):
    """The surface {f(·, time) = level} with the normals ∇f/‖∇f‖ (v, d) at its vertices."""

    time: float
    level: float
    mesh: SimplexMesh
    normals: Float[Tensor, "v d"]


@torch.no_grad()
def extract_frame(morph: Morph, time: float, resolution: int, level: float = 0.0) -> Frame:
    """Extract the surface at one time.

    Args:
        morph: the morph.
        time: from 0 to 1.
        resolution: cells along the longest edge of ``morph.bounds``.
        level: the value of f on the surface.
    """
    mesh = extract_surface(partial(morph, t=time), morph.bounds, resolution, level)
    return Frame(time, level, mesh, normalize(morph.gradient(mesh.vertices, time), dim=1))
