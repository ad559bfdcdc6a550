"""Appearance shared by strips, films, and turntables: resolution, levels, colors, and camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from nsm.geometry.meshing import extract_surface
from nsm.geometry.refinement import refine_bends
from nsm.geometry.topology import vertex_normals
from nsm.morphs.surfaces import Levels, zero_level
from nsm.plots.camera import UP, VIEW, Camera, place_camera
from nsm.plots.colors import ColorFunction, clay_colors
from nsm.plots.renderer import Surface
from nsm.types import Morph, SimplexMesh

#: Least cosine between the normal of f at a vertex and that of the triangles there.
_FACING = 0.3
#: Times and cells along the box of the surfaces that determine the camera.
_CAMERA_TIMES, _CAMERA_RESOLUTION = 9, 48


def zero_levels(morph: Morph) -> Levels:
    """Give the levels at which f itself puts the surface: 0 at all times."""
    return zero_level


class Look(NamedTuple):
    """Appearance of shapes in pictures.

    Attributes:
        resolution: Cells along the box; triangles are finer where the surface bends.
        colors: Computes the colors of points of the shape.
        levels: Gives, for a morph, the value of f on its surface at each time.
        view: Direction from the shape towards the camera (3D).
        up: Direction that is up in the picture (3D).
        zoom: Magnification of shapes (3D); at 1 they fill the picture.

    >>> Look(resolution=64).zoom
    1.0
    """

    resolution: int = 128
    colors: ColorFunction = clay_colors
    levels: Callable[[Morph], Levels] = zero_levels
    view: Sequence[float] = VIEW
    up: Sequence[float] = UP
    zoom: float = 1.0


#: Appearance unless another is given.
LOOK = Look()


@torch.no_grad()
def surface(morph: Morph, time: float, level: float, look: Look) -> Surface:
    """Extract, refine, and color the surface of a morph at one time, ready to be drawn."""
    field, gradient = partial(morph, t=time), partial(morph.gradient, t=time)
    mesh = extract_surface(field, morph.bounds, look.resolution, level)
    mesh, normals = refine_bends(mesh, field, gradient, level)
    normals = facing(normals, mesh)
    colors = look.colors(morph, mesh.vertices, time)
    return Surface(_array(mesh.vertices), mesh.simplices.cpu().numpy(), _array(normals), _array(colors))


def facing(normals: Float[Tensor, "v 3"], mesh: SimplexMesh) -> Float[Tensor, "v 3"]:
    """Replace normals that do not face the way of the triangles around their vertex by the normals of those.

    ∇f points inwards where a badly trained f tears. Light falls on a surface by its normals, so such vertices would be
    black.
    """
    own = vertex_normals(mesh)
    along = (normals * own).sum(1, keepdim=True)
    return torch.where(along > _FACING, normals, own)


@torch.no_grad()
def camera_for(
    morph: Morph, look: Look, times: Sequence[float] | None = None, aspect: float | None = None, turning: bool = False
) -> Camera:
    """Place a camera that holds the shape at some times, by default at all; see `place_camera`."""
    chosen = np.linspace(0, 1, _CAMERA_TIMES).tolist() if times is None else times
    levels = look.levels(morph)
    resolution = min(_CAMERA_RESOLUTION, look.resolution)
    meshes = [extract_surface(partial(morph, t=t), morph.bounds, resolution, levels(t)) for t in chosen]
    points = torch.cat([mesh.vertices for mesh in meshes]).cpu().double().numpy()
    return place_camera(points, look.view, look.up, look.zoom, aspect, turning)


def _array(values: Tensor) -> np.ndarray:
    return values.detach().cpu().double().numpy()
