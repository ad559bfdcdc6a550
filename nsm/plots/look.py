"""How a surface is prepared for a picture: where it is cut from f, how fine, in which colors, seen from where."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

from nsm.geometry.meshing import extract_surface
from nsm.geometry.refinement import refine_bends
from nsm.geometry.topology import vertex_normals
from nsm.morphs.surfaces import Levels, zero_level
from nsm.plots.camera import Camera, place_camera
from nsm.plots.colors import carried_colors
from nsm.plots.studio import Surface
from nsm.types import Morph, SimplexMesh

#: Colors (n, 3), sRGB in 0..1, of points (n, d) of the shape at a time.
Colors = Callable[[Morph, Tensor, float], Tensor]

#: sRGB of surfaces: a light clay that leaves room for shadows.
_CLAY = (0.640, 0.740, 0.890)
#: Points that are carried for their colors, and neighbors among them that color any other.
_CARRIED, _NEIGHBORS = 6000, 4
#: Least cosine between the normal of f at a vertex and that of the triangles there.
_FACING = 0.3
#: Times and cells along the box for the surfaces that settle the camera.
_CAMERA_TIMES, _CAMERA_RESOLUTION = 9, 48


def clay(morph: Morph, points: Float[Tensor, "n d"], time: float) -> Float[Tensor, "n 3"]:
    """The same color everywhere."""
    return points.new_tensor(_CLAY).expand(len(points), 3)


def carried(morph: Morph, points: Float[Tensor, "n d"], time: float) -> Float[Tensor, "n 3"]:
    """Colors (n, 3) by where points come from on the surface at t = 0, as `carried_colors` gives them.

    Only some points are carried; these colors change slowly, and the others take theirs from the nearest.

    Raises:
        InputError: if the morph has no velocity.
    """
    if len(points) <= _CARRIED:
        return carried_colors(morph, points, time)
    chosen = torch.linspace(0, len(points) - 1, _CARRIED, device=points.device).long()
    known = carried_colors(morph, points[chosen], time).cpu().double().numpy()
    places = points.cpu().double().numpy()
    distance, nearest = cKDTree(places[chosen.cpu().numpy()]).query(places, k=_NEIGHBORS)
    weight = 1 / (distance**2 + 1e-12)
    mixed = (weight[..., None] * known[nearest]).sum(1) / weight.sum(1, keepdims=True)
    return torch.as_tensor(mixed).to(points)


def zero_levels(morph: Morph) -> Levels:
    """Surfaces as f has them."""
    return zero_level


class Look(NamedTuple):
    """How shapes look in pictures.

    Attributes:
        resolution: cells along the box; where the surface bends triangles are finer.
        colors: of points of the shape.
        levels: makes, for a morph, the value of f on the surface at each time.
        view: where the viewer stands, a direction (3D).
        up: which way is up (3D).
        zoom: enlarges shapes (3D); at 1 they fill the picture.
    """

    resolution: int = 128
    colors: Colors = clay
    levels: Callable[[Morph], Levels] = zero_levels
    view: Sequence[float] = (0.55, 0.45, 1.0)
    up: Sequence[float] = (0.0, 1.0, 0.0)
    zoom: float = 1.0


#: Unless told otherwise.
LOOK = Look()


@torch.no_grad()
def surface(morph: Morph, time: float, level: float, look: Look) -> Surface:
    """The surface of a morph at one time, ready to be drawn."""
    field, gradient = partial(morph, t=time), partial(morph.gradient, t=time)
    mesh = extract_surface(field, morph.bounds, look.resolution, level)
    mesh, normals = refine_bends(mesh, field, gradient, level)
    normals = facing(normals, mesh)
    colors = look.colors(morph, mesh.vertices, time)
    return Surface(_array(mesh.vertices), mesh.simplices.cpu().numpy(), _array(normals), _array(colors))


def facing(normals: Float[Tensor, "v 3"], mesh: SimplexMesh) -> Float[Tensor, "v 3"]:
    """Normals that face the way of the triangles around: theirs where ∇f does not, as in a rip of a bad f.

    Light falls on a surface by its normals: without this, such vertices would be black.
    """
    own = vertex_normals(mesh)
    along = (normals * own).sum(1, keepdim=True)
    return torch.where(along > _FACING, normals, own)


@torch.no_grad()
def camera_for(
    morph: Morph, look: Look, times: Sequence[float] | None = None, aspect: float | None = None, turning: bool = False
) -> Camera:
    """A camera that holds the shape at some times (the whole morph if None), see `place_camera`."""
    chosen = np.linspace(0, 1, _CAMERA_TIMES).tolist() if times is None else times
    levels = look.levels(morph)
    resolution = min(_CAMERA_RESOLUTION, look.resolution)
    meshes = [extract_surface(partial(morph, t=t), morph.bounds, resolution, levels(t)) for t in chosen]
    points = torch.cat([mesh.vertices for mesh in meshes]).cpu().double().numpy()
    return place_camera(points, look.view, look.up, look.zoom, aspect, turning)


def _array(values: Tensor) -> np.ndarray:
    return values.detach().cpu().double().numpy()
