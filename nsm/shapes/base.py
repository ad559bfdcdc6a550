"""The interfaces of shapes: sets with a surface and an inside."""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from copy import copy, deepcopy
from typing import Any, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm.cli.errors import InputError
from nsm.geometry.grid import evaluate
from nsm.geometry.meshing import extract_surface
from nsm.geometry.projection import newton_to_level
from nsm.geometry.sampling import sample_mesh
from nsm.geometry.volume import volume
from nsm.shapes.sampling import ambient_points
from nsm.shapes.similarity import Similarity
from nsm.types import DistanceSamples, Jet, SimplexMesh, SurfaceSamples

#: Number of cells along the longest side of the grid on which the surface of a field is extracted, by dimension.
SURFACE_RESOLUTION = {2: 512, 3: 128}
#: Number of cells along the longest side of the grid on which the volume of a shape is measured, by dimension.
VOLUME_RESOLUTION = {2: 512, 3: 128}

Field = TypeVar("Field", bound="FieldShape")


def working_box(dim: int) -> Float[Tensor, "2 d"]:
    """Return the corners of [-1, 1]^d, shape (2, d)."""
    return torch.tensor([[-1.0] * dim, [1.0] * dim])


class Shape(ABC):
    """A shape that can be an end of a morph."""

    #: Dimension of the space, 2 or 3.
    dim: int

    @abstractmethod
    def surface_samples(self, count: int, generator: torch.Generator) -> SurfaceSamples:
        """Sample points on the surface, uniformly by area where the data allow it, with outward unit normals."""

    @abstractmethod
    def distance_samples(
        self, count: int, generator: torch.Generator, bounds: Float[Tensor, "2 d"] | None = None
    ) -> DistanceSamples:
        """Sample points with true signed distances, half of them uniform in a box and half near the surface.

        Points near the surface are surface points plus Gaussian offsets (`nsm.shapes.sampling.NEAR_SIGMAS`).

        Args:
            count: Number of points.
            generator: Source of random numbers.
            bounds: Corners of the box, shape (2, d); [-1, 1]^d if None.
        """

    @abstractmethod
    def transformed(self, similarity: Similarity) -> Shape:
        """Apply a similarity after the present pose of the shape, and return the result as a new shape."""

    @abstractmethod
    def exact_bounds(self) -> Float[Tensor, "2 d"]:
        """Compute the axis-aligned bounding box, shape (2, d), in double precision.

        The coordinates of a file may lie far from the origin, where single precision is coarser than the shape.
        """

    def bounds(self) -> Float[Tensor, "2 d"]:
        """Compute the axis-aligned bounding box, shape (2, d), in the default precision."""
        return self.exact_bounds().to(torch.get_default_dtype())

    @abstractmethod
    def volume(self) -> float:
        """Compute the volume of the inside (area in 2D)."""

    @abstractmethod
    def provenance(self) -> dict[str, Any]:
        """Describe the origin of the shape in plain numbers and strings.

        The keys are ``kind``; ``path`` and ``sha256`` if there is a file; and ``similarity``, which maps the
        coordinates of the file (or of the formula) to the box, in the format of `Similarity.read`. Its inverse maps
        results back.
        """

    @abstractmethod
    def content_key(self) -> str:
        """Hash everything that determines the shape, so that a network fitted to it can be found again."""


class FieldShape(nn.Module, Shape):
    """A shape given by a signed distance field g, negative inside.

    The field is defined in local coordinates, and ``placement`` (x ↦ s R x + t) maps them to the box, where the signed
    distance is s g(Rᵀ(x − t)/s). A checkpoint contains ``config()`` and ``state_dict()``.

    Args:
        dim: Dimension d of space.
        similarity: Map from the coordinates of the file, or of the formula, to the box.
        placement: Map from the local coordinates of the field to the box; ``similarity`` if None.
    """

    similarity: Similarity
    placement: Similarity

    def __init__(self, dim: int, similarity: Similarity, placement: Similarity | None = None) -> None:
        super().__init__()
        self.dim = dim
        self.similarity = similarity
        self.placement = similarity if placement is None else placement
        self._local_surface: SimplexMesh | None = None
        self._local_volume: float | None = None

    @abstractmethod
    def local_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Evaluate the signed distance, shape (n,), at points in local coordinates, shape (n, d)."""

    @abstractmethod
    def config(self) -> dict[str, Any]:
        """Return a ``_target_`` and its arguments; instantiating it and loading ``state_dict()`` restores the field."""

    @abstractmethod
    def local_box(self) -> Float[Tensor, "2 d"]:
        """Return the corners of a box in local coordinates that contains the surface, shape (2, d)."""

    def forward(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Evaluate the signed distance s g(Rᵀ(x − t)/s), shape (n,), at points in the box, shape (n, d)."""
        return self.placement.scale * self.local_distance(self.placement.pull_back(x))

    def transformed(self: Field, similarity: Similarity) -> Field:
        """Apply a similarity after the present pose of the shape, and return the result as a new shape."""
        moved = copy(self)
        moved._buffers, moved._modules = dict(self._buffers), deepcopy(self._modules)
        moved.similarity = similarity.after(self.similarity)
        moved.placement = similarity.after(self.placement)
        return moved

    def jet(self, x: Float[Tensor, "n d"]) -> Jet:
        """Evaluate signed distance and gradient at points in the box, shape (n, d); differentiable if x requires it."""
        local = self.local_jet(self.placement.pull_back(x))
        return Jet(self.placement.scale * local.value, self.placement.rotate(local.gradient))

    def local_jet(self, p: Float[Tensor, "n d"]) -> Jet:
        """Evaluate signed distance and gradient at points in local coordinates, shape (n, d)."""
        record = torch.is_grad_enabled() and p.requires_grad
        with torch.enable_grad():
            p = p if record else p.detach().requires_grad_()
            value = self.local_distance(p)
            (gradient,) = torch.autograd.grad(value.sum(), p, create_graph=record)
        return Jet(value if record else value.detach(), gradient)

    def surface(self) -> SimplexMesh:
        """Extract the surface in the coordinates of the box."""
        local = self.local_surface()
        return SimplexMesh(self.placement.apply(local.vertices), local.simplices)

    def local_surface(self) -> SimplexMesh:
        """Extract the surface in local coordinates once, and project its vertices to the zero level."""
        if self._local_surface is None:
            mesh = extract_surface(self._local_field, self.local_box(), self._resolution(SURFACE_RESOLUTION))
            if len(mesh.simplices) == 0:
                raise InputError(
                    f"The `{self.provenance()['kind']}` must have a surface in its domain, got none. Try a larger "
                    "shape."
                )
            self._local_surface = SimplexMesh(self._onto_surface(mesh.vertices), mesh.simplices)
        return self._local_surface

    def content_key(self) -> str:
        """Hash configuration and state with SHA-256."""
        digest = hashlib.sha256(json.dumps(self.config(), sort_keys=True).encode())
        for value in self.state_dict().values():
            digest.update(value.cpu().numpy().tobytes())
        return digest.hexdigest()

    def exact_bounds(self) -> Float[Tensor, "2 d"]:
        """Compute the bounding box of the extracted surface."""
        vertices = self.placement.apply(self.local_surface().vertices.double())
        return torch.stack([vertices.amin(0), vertices.amax(0)])

    def volume(self) -> float:
        """Compute the volume of the inside from fractions of cells on a grid over the local box, once."""
        if self._local_volume is None:
            self._local_volume = volume(self._local_field, self.local_box(), self._resolution(VOLUME_RESOLUTION))
        return self.placement.scale**self.dim * self._local_volume

    @torch.no_grad()
    def surface_samples(self, count: int, generator: torch.Generator) -> SurfaceSamples:
        """Sample points by area on the extracted surface, and project them to the zero level; normals are ∇g/‖∇g‖."""
        drawn, _ = sample_mesh(self.surface(), count, generator)
        points, jet = newton_to_level(self.jet, drawn, steps=2)  # between vertices that lie on the surface
        return SurfaceSamples(points, nn.functional.normalize(jet.gradient, dim=1))

    @torch.no_grad()
    def distance_samples(
        self, count: int, generator: torch.Generator, bounds: Float[Tensor, "2 d"] | None = None
    ) -> DistanceSamples:
        """Sample points with true distances; those near the surface lie around the extracted surface."""
        surface, _ = sample_mesh(self.surface(), max(count // 2, 1), generator)
        points = ambient_points(surface, count, generator, working_box(self.dim) if bounds is None else bounds)
        return DistanceSamples(points, self.true_distance(points))

    def true_distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Evaluate the true signed distance at points in the box: the field itself, unless a subclass corrects it."""
        return evaluate(self, x)

    def _resolution(self, standard: dict[int, int]) -> int:
        """Return the number of cells along the longest side of the local box."""
        return standard[self.dim]

    @torch.no_grad()
    def _local_field(self, p: Tensor) -> Tensor:
        return self.local_distance(p)

    @torch.no_grad()
    def _onto_surface(self, p: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Project points of an extracted surface to the zero level by one Newton step of at most half a cell."""
        return newton_to_level(self.local_jet, p, steps=1, reach=self._local_cell() / 2)[0]

    def _local_cell(self) -> float:
        """Return the edge of the cells on which the surface is extracted, in local coordinates."""
        low, high = self.local_box()
        return float((high - low).max()) / self._resolution(SURFACE_RESOLUTION)
