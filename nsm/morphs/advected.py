"""Surfaces of a morph carried by its velocity: vertices move, connectivity and attributes stay as they are."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.advection import DEFAULT_METHOD, Progress, Projection, RungeKutta, VelocityField, advect
from nsm.geometry.distance import closest_points
from nsm.geometry.meshing import extract_surface
from nsm.geometry.projection import project_to_level
from nsm.morphs.surfaces import extract_frame, zero_level
from nsm.shapes import FieldShape, Similarity
from nsm.shapes.textured import Attributes, TexturedMesh
from nsm.types import Jet, Morph, SimplexMesh

log = logging.getLogger(__name__)

#: A mesh this far from the surface at t = 0 in the mean, as a share of the box, is probably another shape or pose.
_FAR = 0.02


class Carried(NamedTuple):
    """A mesh at k times: the same simplices (m, d) and attributes, and at each time other vertices (v, d)."""

    times: list[float]
    vertices: Float[Tensor, "k v d"]
    simplices: Int[Tensor, "m d"]
    attributes: Attributes = Attributes()

    def mesh(self, index: int) -> SimplexMesh:
        """The mesh at ``times[index]``."""
        return SimplexMesh(self.vertices[index], self.simplices)


class Correspondences(NamedTuple):
    """Which point of the target surface each vertex of the source has become.

    Attributes:
        source_points: vertices (v, d) at t = 0.
        target_points: the same vertices on the surface of the target shape (v, d).
        distances: from where each was carried to by t = 1 to its ``target_points`` (v,).
        simplices: (m, d), of both.
        attributes: of both.
    """

    source_points: Float[Tensor, "v d"]
    target_points: Float[Tensor, "v d"]
    distances: Float[Tensor, " v"]
    simplices: Int[Tensor, "m d"]
    attributes: Attributes = Attributes()


class LevelProjection:
    """Moves points to the surface {f(·, t) = c(t)} of a morph; a `nsm.geometry.advection.Projection`.

    Args:
        morph: the morph.
        level: c.

    Attributes:
        asked: how many times a point was to be moved, so far.
        stayed: how many times it found no surface within reach, and stayed where it was.
    """

    def __init__(self, morph: Morph, level: Callable[[float], float] = zero_level) -> None:
        self.morph, self.level = morph, level
        self.asked = self.stayed = 0

    def __call__(self, x: Float[Tensor, "n d"], t: float) -> Float[Tensor, "n d"]:
        """The points (n, d) of the surface at time t next to x."""

        def jet(points: Tensor) -> Jet:
            return Jet(self.morph(points, t), self.morph.gradient(points, t))

        projected = project_to_level(jet, x, self.level(t))
        self.asked += len(x)
        self.stayed += int(projected.stayed.sum())
        return projected.points


def velocity_of(morph: Morph) -> VelocityField:
    """The velocity V(x, t) (n, d) of a morph.

    Raises:
        InputError: if its method has none.
    """
    if not morph.has_velocity:
        raise InputError(
            "this morph has no velocity, so nothing can be carried along it: give one that was trained with a "
            "velocity, such as by method=adadiv"
        )
    return cast(VelocityField, morph.velocity)


def carry_surface(
    morph: Morph,
    times: Sequence[float],
    resolution: int,
    method: RungeKutta = DEFAULT_METHOD,
    project: Projection | None = None,
    progress: Progress | None = None,
) -> Carried:
    """Carry the surface of a morph at t = 0 to some times.

    Args:
        morph: the morph.
        times: from 0 to 1.
        resolution: cells along the longest edge of ``morph.bounds`` for the surface.
        method, project, progress: of `nsm.geometry.advection.advect`; ``LevelProjection(morph)`` keeps to the surface.

    Raises:
        InputError: if the morph has no velocity, or no surface at t = 0.
    """
    velocity_of(morph)  # before the surface is extracted for nothing
    mesh = extract_frame(morph, 0.0, resolution).mesh
    if not len(mesh.simplices):
        raise InputError(
            "this morph has no surface at t = 0, so there is nothing to carry: give a higher resolution, or another "
            "morph"
        )
    return carry_mesh(morph, TexturedMesh(mesh), times, method, project, progress)


def carry_mesh(
    morph: Morph,
    source: TexturedMesh,
    times: Sequence[float],
    method: RungeKutta = DEFAULT_METHOD,
    project: Projection | None = None,
    progress: Progress | None = None,
) -> Carried:
    """Carry a mesh that lies on the surface of a morph at t = 0 (see `placed`) to some times.

    Vertices at one place, as a file has them at the seams of a texture, stay at one place. With a projection all
    frames lie on the surface, the first too.

    Args:
        morph: the morph.
        source: in the coordinates of the morph.
        times: from 0 to 1.
        method, project, progress: of `nsm.geometry.advection.advect`.

    Raises:
        InputError: if the morph has no velocity, or the mesh no vertices.
    """
    mesh = source.mesh
    if not len(mesh.vertices):
        raise InputError("a mesh without vertices cannot be carried: give one with a surface")
    places, place_of = torch.unique(mesh.vertices.to(morph.bounds.device), dim=0, return_inverse=True)
    start = places if project is None else project(places, 0.0)
    carried = advect(velocity_of(morph), start, [0.0, *times], method, project, progress)[1:]
    if isinstance(project, LevelProjection) and project.stayed:
        message = "%d of %d moves to the surface found none within reach: those points went on as they were carried"
        log.warning(message, project.stayed, project.asked)
    return Carried([float(t) for t in times], carried[:, place_of], mesh.simplices.to(place_of), source.attributes)


def correspondences(morph: Morph, carried: Carried, resolution: int) -> Correspondences:
    """Which point of the target's surface each carried vertex has become.

    Vertices that were carried to t = 1, with a projection if they shall keep to the surface on the way, go to the
    closest point of the target shape.

    Args:
        morph: the morph.
        carried: its first time 0 and its last 1.
        resolution: cells along the longest edge of ``morph.bounds`` for the surface of the target.

    Raises:
        InputError: if the times do not go from 0 to 1, or the target has no surface.
    """
    if carried.times[0] != 0 or carried.times[-1] != 1:
        raise InputError(
            f"points carried from t = {carried.times[0]:g} to {carried.times[-1]:g} do not lead from the source to the "
            "target: give times from 0 to 1"
        )
    target = extract_surface(morph.target, morph.bounds, resolution)
    if not len(target.simplices):
        raise InputError(
            "the target of this morph has no surface in its box, so nothing corresponds: give another morph"
        )
    closest = closest_points(carried.vertices[-1], target)
    return Correspondences(
        carried.vertices[0], closest.points, closest.distances, carried.simplices, carried.attributes
    )


def placed(morph: Morph, source: TexturedMesh) -> TexturedMesh:
    """A mesh in the coordinates of the source's file, taken to where the source lies in the box of the morph.

    Raises:
        InputError: if the morph does not know the coordinates of its source, or has another dimension.
    """
    similarity = similarity_of(morph)
    vertices = similarity.apply(source.mesh.vertices).to(morph.bounds)
    away = float(morph(vertices, 0.0).abs().mean())
    if away > _FAR * float((morph.bounds[1] - morph.bounds[0]).max()):
        log.warning(
            "the mesh lies %.2g from the surface at t = 0 in the mean: it should be the source of this morph, in the "
            "coordinates of the file that it was trained with",
            away,
        )
    return source._replace(mesh=SimplexMesh(vertices, source.mesh.simplices.to(vertices.device)))


def similarity_of(morph: Morph) -> Similarity:
    """What takes the coordinates of the source's file to the box of the morph.

    Raises:
        InputError: if the morph does not know it, or is not of three dimensions.
    """
    if morph.dim != 3 or not isinstance(morph.source, FieldShape):
        raise InputError(
            f"a mesh cannot be placed on this {morph.dim}D morph, whose source knows no coordinates of a file: leave "
            "out the mesh, and the surface of the morph is carried"
        )
    return morph.source.similarity
