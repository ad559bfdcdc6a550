"""The surfaces that an export consists of: extracted at each time, or one that is carried along."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import NamedTuple, cast

import torch
from torch import Tensor
from torch.nn.functional import normalize

from nsm.export.formats import Request
from nsm.geometry.advection import Progress
from nsm.morphs.advected import (
    Carried,
    LevelProjection,
    carry_mesh,
    carry_surface,
    correspondences,
    placed,
    velocity_of,
)
from nsm.morphs.surfaces import ExactVolume, Frame, extract_frame, zero_level
from nsm.plots.colors import position_colors
from nsm.shapes import FieldShape, Similarity
from nsm.shapes.textured import Attributes, load_textured
from nsm.types import Morph, SimplexMesh


class Surfaces(ABC):
    """The surfaces of a morph at some times, in the coordinates that were asked for.

    Args:
        request: what was asked for.
    """

    def __init__(self, request: Request) -> None:
        self.request, self.morph = request, request.morph
        self._back = coordinates(request.morph, request.frame)

    @property
    @abstractmethod
    def attributes(self) -> Attributes:
        """What the vertices have at all times."""

    @abstractmethod
    def extract(self, time: float) -> Frame:
        """The surface at one of the times, in the coordinates of the morph."""

    def __call__(self, time: float) -> Frame:
        """The surface at one of the times, in double precision: a file's coordinates may lie far from its origin."""
        frame = self.extract(time)
        mesh = self.place(frame.mesh)
        return Frame(frame.time, frame.level, mesh, self._back.rotate(frame.normals.double()))

    def place(self, mesh: SimplexMesh) -> SimplexMesh:
        """A mesh in the coordinates of the morph, taken to those that were asked for."""
        return SimplexMesh(self._back.apply(mesh.vertices.double()), mesh.simplices)


class Extracted(Surfaces):
    """At each time the level set of f, of connectivity of its own."""

    def __init__(self, request: Request) -> None:
        super().__init__(request)
        self._levels = ExactVolume(self.morph, request.resolution) if request.exact_volume else zero_level

    @property
    def attributes(self) -> Attributes:
        return Attributes()

    def extract(self, time: float) -> Frame:
        return extract_frame(self.morph, time, self.request.resolution, self._levels(time))


class CarriedAlong(Surfaces):
    """A mesh that lies on the surface at t = 0, carried along V: the same triangles at all times.

    Args:
        request: what was asked for.

    Attributes:
        progress: of `nsm.geometry.advection.advect`, told while the mesh is carried, at the first call.

    Raises:
        InputError: if the morph has no velocity, or the mesh cannot be read.
    """

    def __init__(self, request: Request) -> None:
        super().__init__(request)
        velocity_of(self.morph)
        self.progress: Progress | None = None
        self._mesh = None if request.mesh is None else placed(self.morph, load_textured(request.mesh))

    @property
    def attributes(self) -> Attributes:
        """Those of the mesh; colors by where each vertex starts if it has neither colors nor a place on a texture."""
        given = self._carried.attributes
        return given if given.colors is not None or given.uv is not None else Attributes(colors=self._start_colors)

    def extract(self, time: float) -> Frame:
        mesh = self._carried.mesh(self._carried.times.index(time))
        with torch.no_grad():
            return Frame(time, 0.0, mesh, normalize(self.morph.gradient(mesh.vertices, time), dim=1))

    def pair(self) -> Pair:
        """Both ends with the same colors where they correspond, in the coordinates that were asked for."""
        found = correspondences(self.morph, self._carried, self.request.resolution)
        colors = self.attributes.colors
        return Pair(
            self.place(SimplexMesh(found.source_points, found.simplices)),
            self.place(SimplexMesh(found.target_points, found.simplices)),
            found.distances.double() * self._back.scale,
            self._start_colors if colors is None else colors,
        )

    @cached_property
    def _carried(self) -> Carried:
        request, project = self.request, LevelProjection(self.morph) if self.request.project else None
        times = sorted({0.0, *request.times, 1.0})
        if self._mesh is None:
            return carry_surface(self.morph, times, request.resolution, project=project, progress=self.progress)
        return carry_mesh(self.morph, self._mesh, times, project=project, progress=self.progress)

    @cached_property
    def _start_colors(self) -> Tensor:
        start = self._carried.vertices[0]
        return position_colors(start, torch.stack([start.amin(0), start.amax(0)]))


class Pair(NamedTuple):
    """A mesh on the source and the same mesh on the target: vertices of one number correspond.

    Attributes:
        source, target: meshes of the same simplices.
        distances: by which the carried vertices missed the target (v,).
        colors: of both (v, 3).
    """

    source: SimplexMesh
    target: SimplexMesh
    distances: Tensor
    colors: Tensor


def coordinates(morph: Morph, frame: str) -> Similarity:
    """What takes points of the box to the coordinates that a request names."""
    if frame == "morph":
        return Similarity.identity(morph.dim)
    end = {"source": morph.source, "target": morph.target}[frame]
    return cast(FieldShape, end).similarity.inverse()
