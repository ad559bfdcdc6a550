"""Meshes advected by the velocity of a morph: vertices move, while connectivity and attributes stay the same."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.advection import DEFAULT_METHOD, Progress, RungeKutta, VelocityField, advect
from nsm.geometry.distance import closest_points
from nsm.geometry.meshing import extract_surface
from nsm.geometry.projection import project_to_level
from nsm.morphs.surfaces import extract_frame, zero_level
from nsm.shapes import FieldShape, Similarity
from nsm.shapes.textured import Attributes, TexturedMesh
from nsm.types import Jet, Morph, SimplexMesh

log = logging.getLogger(__name__)

#: Mean distance of a mesh from the surface at t = 0, relative to the box, above which it is probably another shape.
_FAR = 0.02


class AdvectedMesh(NamedTuple):
    """A mesh at k times, with the same simplices and attributes at each time.

    Attributes:
        times: The k times.
        vertices: Positions of the vertices at each time, shape (k, v, d).
        simplices: Indices of the vertices of each simplex, shape (m, d).
        attributes: Colors and texture coordinates of the vertices.
    """

    times: list[float]
    vertices: Float[Tensor, "k v d"]
    simplices: Int[Tensor, "m d"]
    attributes: Attributes = Attributes()

    def mesh(self, index: int) -> SimplexMesh:
        """The mesh at ``times[index]``."""
        return SimplexMesh(self.vertices[index], self.simplices)


class Correspondences(NamedTuple):
    """Points of the target surface to which the vertices of the source correspond.

    Attributes:
        source_points: Vertices at t = 0, shape (v, d).
        target_points: The same vertices on the surface of the target shape, shape (v, d).
        distances: Distance of each vertex, advected to t = 1, from its target point, shape (v,).
        simplices: Simplices of both meshes, shape (m, d).
        attributes: Attributes of both meshes.
    """

    source_points: Float[Tensor, "v d"]
    target_points: Float[Tensor, "v d"]
    distances: Float[Tensor, " v"]
    simplices: Int[Tensor, "m d"]
    attributes: Attributes = Attributes()


class LevelProjection:
    """Projection of points to the surface {f(·, t) = c(t)} of a morph, for `nsm.geometry.advection.advect`.

    Args:
        morph: The morph.
        level: c.

    Attributes:
        requested: Number of projections so far, over all points.
        failed: Number of them that found no surface within reach, and left the point where it was.
    """

    def __init__(self, morph: Morph, level: Callable[[float], float] = zero_level) -> None:
        self.morph, self.level = morph, level
        self.requested = self.failed = 0

    def __call__(self, x: Float[Tensor, "n d"], t: float) -> Float[Tensor, "n d"]:
        """Points of the surface at time t nearest to x, shape (n, d)."""

        def jet(points: Tensor) -> Jet:
            return Jet(self.morph(points, t), self.morph.gradient(points, t))

        projected = project_to_level(jet, x, self.level(t))
        self.requested += len(x)
        self.failed += int(projected.stayed.sum())
        return projected.points


def velocity_of(morph: Morph) -> VelocityField:
    """The velocity V(x, t) of a morph, which returns tensors of shape (n, d).

    Raises:
        InputError: If the morph has no velocity.
    """
    if not morph.has_velocity:
        raise InputError(
            "The morph must have a velocity to advect a surface, got one without. Try a morph trained with "
            "`method=adadiv`."
        )
    return cast(VelocityField, morph.velocity)


def advect_surface(
    morph: Morph,
    times: Sequence[float],
    resolution: int,
    method: RungeKutta = DEFAULT_METHOD,
    project: LevelProjection | None = None,
    progress: Progress | None = None,
) -> AdvectedMesh:
    """Advect the surface of a morph at t = 0 to other times.

    Args:
        morph: The morph.
        times: Times in [0, 1].
        resolution: Cells along the longest edge of ``morph.bounds`` with which the surface is extracted.
        method: Integrator of the velocity.
        project: Projection after every step; ``LevelProjection(morph)`` keeps the vertices on the surface.
        progress: Called with the number of finished steps and of all steps.

    Raises:
        InputError: If the morph has no velocity, or no surface at t = 0.
    """
    velocity_of(morph)  # fail before the surface is extracted
    mesh = extract_frame(morph, 0.0, resolution).mesh
    if not len(mesh.simplices):
        raise InputError(
            f"`resolution` must be high enough to show a surface at t = 0, got {resolution}. Try "
            f"`resolution={2 * resolution}`, or another morph."
        )
    return advect_mesh(morph, TexturedMesh(mesh), times, method, project, progress)


def advect_mesh(
    morph: Morph,
    source: TexturedMesh,
    times: Sequence[float],
    method: RungeKutta = DEFAULT_METHOD,
    project: LevelProjection | None = None,
    progress: Progress | None = None,
) -> AdvectedMesh:
    """Advect a mesh that lies on the surface of a morph at t = 0 (see `place_mesh`) to other times.

    Vertices at the same position, which files have at the seams of a texture, stay together. With a projection the
    mesh lies on the surface at all times, including the first one.

    Args:
        morph: The morph.
        source: Mesh in the coordinates of the morph.
        times: Times in [0, 1].
        method: Integrator of the velocity.
        project: Projection after every step; ``LevelProjection(morph)`` keeps the vertices on the surface.
        progress: Called with the number of finished steps and of all steps.

    Raises:
        InputError: If the morph has no velocity, or the mesh has no vertices.
    """
    mesh = source.mesh
    if not len(mesh.vertices):
        raise InputError("`mesh` must have vertices to be advected, got none. Try a mesh with a surface.")
    places, place_of = torch.unique(mesh.vertices.to(morph.bounds.device), dim=0, return_inverse=True)
    start = places if project is None else project(places, 0.0)
    advected = advect(velocity_of(morph), start, [0.0, *times], method, project, progress)[1:]
    if project is not None and project.failed:
        message = "%d of %d projections found no surface within reach; those points moved on without projection."
        log.warning(message, project.failed, project.requested)
    return AdvectedMesh(
        [float(t) for t in times], advected[:, place_of], mesh.simplices.to(place_of), source.attributes
    )


def correspondences(morph: Morph, advected: AdvectedMesh, resolution: int) -> Correspondences:
    """Find the point of the target's surface to which each advected vertex corresponds.

    It is the point of the target shape that is closest to the vertex at t = 1.

    Args:
        morph: The morph.
        advected: Mesh whose first time is 0 and whose last time is 1.
        resolution: Cells along the longest edge of ``morph.bounds`` with which the target is extracted.

    Raises:
        InputError: If the times do not go from 0 to 1, or the target has no surface.
    """
    first, last = advected.times[0], advected.times[-1]
    if (first, last) != (0, 1):
        raise InputError(f"`times` must go from 0 to 1 for correspondences, got {first:g} to {last:g}. Try `times=24`.")
    target = extract_surface(morph.target, morph.bounds, resolution)
    if not len(target.simplices):
        raise InputError(
            f"`resolution` must be high enough to show the target in the box of the morph, got {resolution}. Try "
            f"`resolution={2 * resolution}`, or another morph."
        )
    closest = closest_points(advected.vertices[-1], target)
    return Correspondences(
        advected.vertices[0], closest.points, closest.distances, advected.simplices, advected.attributes
    )


def place_mesh(morph: Morph, source: TexturedMesh) -> TexturedMesh:
    """Move a mesh from the coordinates of the source's file to those of the morph.

    Raises:
        InputError: If the morph does not know the coordinates of its source, or is not of three dimensions.
    """
    similarity = similarity_of(morph)
    vertices = similarity.apply(source.mesh.vertices).to(morph.bounds)
    distance = float(morph(vertices, 0.0).abs().mean())
    if distance > _FAR * float((morph.bounds[1] - morph.bounds[0]).max()):
        log.warning(
            "The mean distance of the mesh from the surface at t = 0 is %.2g. Try the mesh of the source, in the "
            "coordinates of the file with which the morph was trained.",
            distance,
        )
    return source._replace(mesh=SimplexMesh(vertices, source.mesh.simplices.to(vertices.device)))


def similarity_of(morph: Morph) -> Similarity:
    """The similarity from the coordinates of the source's file to those of the morph.

    Raises:
        InputError: If the morph does not know it, or is not of three dimensions.
    """
    if morph.dim != 3 or not isinstance(morph.source, FieldShape):
        raise InputError(
            f"`mesh` must be left out for this {morph.dim}D morph, whose source has no coordinates of a file. Try "
            "`mesh=null`, which advects the surface of the morph."
        )
    return morph.source.similarity
