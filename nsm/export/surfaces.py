"""Surfaces that an export consists of: extracted at each time, or one mesh that is advected."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from pathlib import Path
from typing import cast

import torch
from torch import Tensor
from torch.nn.functional import normalize

from nsm.cli.progress import Progress
from nsm.export.correspondences import write_correspondences
from nsm.export.request import Request
from nsm.morphs.advected import (
    AdvectedMesh,
    LevelProjection,
    advect_mesh,
    advect_surface,
    correspondences,
    place_mesh,
    velocity_of,
)
from nsm.morphs.surfaces import ExactVolume, Frame, extract_frame, zero_level
from nsm.plots.colors import position_colors
from nsm.shapes import FieldShape, Similarity
from nsm.shapes.textured import Attributes, load_textured
from nsm.types import Morph, SimplexMesh


class Surfaces(ABC):
    """Surfaces of a morph at the requested times, in the requested coordinates.

    Args:
        request: The request.
    """

    def __init__(self, request: Request) -> None:
        self.request, self.morph = request, request.morph
        self._back = similarity_to(request.morph, request.coordinates)

    @property
    @abstractmethod
    def attributes(self) -> Attributes:
        """Colors or texture of the vertices, the same at all times."""

    @abstractmethod
    def extract(self, time: float) -> Frame:
        """Return the surface at one of the times, in the coordinates of the morph."""

    @abstractmethod
    def prepare(self, progress: Progress) -> None:
        """Compute what all frames share; to be called before anything else is asked for."""

    @abstractmethod
    def write_companions(self, folder: Path) -> None:
        """Write the files that accompany the frames."""

    def __call__(self, time: float) -> Frame:
        """Return the surface at one of the times, in double precision because a file's coordinates may be large."""
        frame = self.extract(time)
        return Frame(frame.time, frame.level, self.place(frame.mesh), self._back.rotate(frame.normals.double()))

    def place(self, mesh: SimplexMesh) -> SimplexMesh:
        """Take a mesh from the coordinates of the morph to the requested ones."""
        return SimplexMesh(self._back.apply(mesh.vertices.double()), mesh.simplices)


class Extracted(Surfaces):
    """Level sets of f, extracted at each time, each with its own connectivity."""

    def __init__(self, request: Request) -> None:
        super().__init__(request)
        self._levels = ExactVolume(self.morph, request.resolution) if request.exact_volume else zero_level

    @property
    def attributes(self) -> Attributes:
        return Attributes()

    def extract(self, time: float) -> Frame:
        return extract_frame(self.morph, time, self.request.resolution, self._levels(time))

    def prepare(self, progress: Progress) -> None:
        """Do nothing: frames share nothing."""

    def write_companions(self, folder: Path) -> None:
        """Write nothing."""


class Advected(Surfaces):
    """A mesh on the surface at t = 0, advected along V: the same triangles at all times.

    Args:
        request: The request.

    Raises:
        InputError: If the morph has no velocity, or the mesh cannot be read.
    """

    def __init__(self, request: Request) -> None:
        super().__init__(request)
        velocity_of(self.morph)
        self._mesh = None if request.mesh is None else place_mesh(self.morph, load_textured(request.mesh))
        self._advected: AdvectedMesh

    @property
    def attributes(self) -> Attributes:
        """Those of the given mesh; colors by position at t = 0 if it has neither colors nor texture coordinates."""
        given = self._advected.attributes
        return given if given.colors is not None or given.uv is not None else Attributes(colors=self._start_colors)

    def extract(self, time: float) -> Frame:
        mesh = self._advected.mesh(self._advected.times.index(time))
        with torch.no_grad():
            return Frame(time, 0.0, mesh, normalize(self.morph.gradient(mesh.vertices, time), dim=1))

    def prepare(self, progress: Progress) -> None:
        progress.stage("advecting")
        project = LevelProjection(self.morph) if self.request.project else None
        times = sorted({0.0, *self.request.times, 1.0})
        if self._mesh is None:
            resolution = self.request.resolution
            self._advected = advect_surface(self.morph, times, resolution, project=project, progress=progress.update)
        else:
            self._advected = advect_mesh(self.morph, self._mesh, times, project=project, progress=progress.update)

    def write_companions(self, folder: Path) -> None:
        """Write correspondences if they are requested."""
        if not self.request.correspondences:
            return
        found = correspondences(self.morph, self._advected, self.request.resolution)
        colors = self.attributes.colors
        points = {"source": found.source_points, "target": found.target_points}
        write_correspondences(
            folder,
            self.place(SimplexMesh(found.source_points, found.simplices)),
            self.place(SimplexMesh(found.target_points, found.simplices)),
            found.distances.double() * self._back.scale,
            self._start_colors if colors is None else colors,
            {end: similarity_to(self.morph, end).apply(there.double()) for end, there in points.items()},
        )

    @cached_property
    def _start_colors(self) -> Tensor:
        start = self._advected.vertices[0]
        return position_colors(start, torch.stack([start.amin(0), start.amax(0)]))


def surfaces_of(request: Request) -> Surfaces:
    """Choose the surfaces of a request."""
    return Advected(request) if request.advect else Extracted(request)


def similarity_to(morph: Morph, coordinates: str) -> Similarity:
    """Return the similarity from the box of a morph to a coordinate system of `COORDINATES`."""
    if coordinates == "morph":
        return Similarity.identity(morph.dim)
    end = {"source": morph.source, "target": morph.target}[coordinates]
    return cast(FieldShape, end).similarity.inverse()
