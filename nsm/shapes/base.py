"""Shapes: what has a surface and an inside."""

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
from nsm.geometry.volume import volume
from nsm.shapes.sampling import ambient_points, sample_mesh_surface
from nsm.shapes.similarity import Similarity
from nsm.types import DistanceSamples, Jet, SimplexMesh, SurfaceSamples

#: Cells along the longest side of the grid that a field's surface is extracted on before points are drawn.
SURFACE_RESOLUTION = {2: 512, 3: 128}
#: The same for volumes.
VOLUME_RESOLUTION = {2: 512, 3: 128}

Field = TypeVar("Field", bound="FieldShape")


def working_box(dim: int) -> Float[Tensor, "2 d"]:
    """The corners of [-1, 1]^d."""
    return torch.tensor([[-1.0] * dim, [1.0] * dim])


class Shape(ABC):
    """A shape: what a config names, whatever it was made from."""

    #: Dimension of the space, 2 or 3.
    dim: int

    @abstractmethod
    def surface_samples(self, count: int, generator: torch.Generator) -> SurfaceSamples:
        """Points drawn on the surface, uniformly by area where the data allow it, with outward unit normals."""

    @abstractmethod
    def distance_samples(
        self, count: int, generator: torch.Generator, bounds: Float[Tensor, "2 d"] | None = None
    ) -> DistanceSamples:
        """Points with true signed distances: half uniform in ``bounds`` ([-1, 1]^d if None), half near the surface.

        The near ones are surface points plus Gaussian offsets (`nsm.shapes.sampling.NEAR_SIGMAS`).
        """

    @abstractmethod
    def transformed(self, similarity: Similarity) -> Shape:
        """The shape moved by a similarity, on top of what it has."""

    @abstractmethod
    def exact_bounds(self) -> Float[Tensor, "2 d"]:
        """Corners of the smallest axis-parallel box that holds the shape, lowest first, in double precision.

        The coordinates of a file may lie far from their origin, where single precision is coarser than the shape.
        """

    def bounds(self) -> Float[Tensor, "2 d"]:
        """The same in the default precision."""
        return self.exact_bounds().to(torch.get_default_dtype())

    @abstractmethod
    def volume(self) -> float:
        """Volume (area in 2D) of the inside."""

    @abstractmethod
    def provenance(self) -> dict[str, Any]:
        """Where the shape comes from, in plain numbers and strings.

        ``kind``, ``path`` and ``sha256`` where there is a file, and ``similarity``: what took the coordinates of the
        file (or of the formula) to the box, as `Similarity.read` reads it; its inverse takes results back.
        """

    @abstractmethod
    def content_key(self) -> str:
        """A hash of all that decides the shape: equal for equal shapes, so that a fit to it can be found again."""


class FieldShape(nn.Module, Shape):
    """A shape that is itself a signed distance field g, negative inside.

    A field is defined in its own coordinates and carried to the box by ``placement`` (x ↦ s R x + t), so that
    the field in the box is s g(Rᵀ(x − t)/s). A checkpoint keeps it as ``config()`` and ``state_dict()``.

    Args:
        dim: dimension d.
        similarity: from the coordinates of the file, or of the formula, to the box.
        placement: from the field's own coordinates to the box; ``similarity`` if None.
    """

    similarity: Similarity
    placement: Similarity

    def __init__(self, dim: int, similarity: Similarity, placement: Similarity | None = None) -> None:
        super().__init__()
        self.dim = dim
        self.similarity = similarity
        self.placement = similarity if placement is None else placement
        self._own_surface: SimplexMesh | None = None

    @abstractmethod
    def own_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Signed distance (n,) at p (n, d) in the field's own coordinates."""

    @abstractmethod
    def config(self) -> dict[str, Any]:
        """A ``_target_`` and its arguments: instantiating it and loading ``state_dict()`` gives this field again."""

    @abstractmethod
    def own_box(self) -> Float[Tensor, "2 d"]:
        """A box in the field's own coordinates that holds its surface."""

    def forward(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Signed distance (n,) at x (n, d) in the box: s g(Rᵀ(x − t)/s)."""
        return self.placement.scale * self.own_distance(self.placement.pull_back(x))

    def transformed(self: Field, similarity: Similarity) -> Field:
        """The shape moved by a similarity, on top of what it has: x ↦ s g(Rᵀ(x − t)/s)."""
        moved = copy(self)
        moved._buffers, moved._modules = dict(self._buffers), deepcopy(self._modules)
        moved.similarity = similarity.after(self.similarity)
        moved.placement = similarity.after(self.placement)
        return moved

    def jet(self, x: Float[Tensor, "n d"]) -> Jet:
        """Value (n,) and gradient (n, d) at x (n, d) in the box, differentiable where the caller records a graph."""
        own = self.own_jet(self.placement.pull_back(x))
        return Jet(self.placement.scale * own.value, self.placement.turn(own.gradient))

    def own_jet(self, p: Float[Tensor, "n d"]) -> Jet:
        """Value (n,) and gradient (n, d) at p (n, d) in the field's own coordinates."""
        record = torch.is_grad_enabled() and p.requires_grad
        with torch.enable_grad():
            p = p if record else p.detach().requires_grad_()
            value = self.own_distance(p)
            (gradient,) = torch.autograd.grad(value.sum(), p, create_graph=record)
        return Jet(value if record else value.detach(), gradient)

    def surface(self) -> SimplexMesh:
        """The surface in the box."""
        own = self.own_surface()
        return SimplexMesh(self.placement.apply(own.vertices), own.simplices)

    def own_surface(self) -> SimplexMesh:
        """The surface in own coordinates, extracted once on a grid over the field's own box and moved to its zeros."""
        if self._own_surface is None:
            mesh = extract_surface(self._own_field, self.own_box(), self._resolution(SURFACE_RESOLUTION))
            if len(mesh.simplices) == 0:
                raise InputError(
                    f"The {self.provenance()['kind']} must have a surface in its domain, got none. Try a shape with an "
                    "inside that is larger."
                )
            self._own_surface = SimplexMesh(self._onto_surface(mesh.vertices), mesh.simplices)
        return self._own_surface

    def content_key(self) -> str:
        """SHA-256 of the configuration and the state."""
        digest = hashlib.sha256(json.dumps(self.config(), sort_keys=True).encode())
        for value in self.state_dict().values():
            digest.update(value.cpu().numpy().tobytes())
        return digest.hexdigest()

    def exact_bounds(self) -> Float[Tensor, "2 d"]:
        """Corners of the box around the extracted surface."""
        vertices = self.placement.apply(self.own_surface().vertices.double())
        return torch.stack([vertices.amin(0), vertices.amax(0)])

    def volume(self) -> float:
        """Volume of the inside, from sub-voxel fractions on a grid over the field's own box."""
        own = volume(self._own_field, self.own_box(), self._resolution(VOLUME_RESOLUTION))
        return self.placement.scale**self.dim * own

    @torch.no_grad()
    def surface_samples(self, count: int, generator: torch.Generator) -> SurfaceSamples:
        """Points drawn by area on the extracted surface, then moved to the zero level; normals ∇g/|∇g|."""
        drawn, _ = sample_mesh_surface(self.surface(), count, generator)
        points, jet = newton_to_level(self.jet, drawn, steps=2)  # between vertices that lie on the surface
        return SurfaceSamples(points, nn.functional.normalize(jet.gradient, dim=1))

    @torch.no_grad()
    def distance_samples(
        self, count: int, generator: torch.Generator, bounds: Float[Tensor, "2 d"] | None = None
    ) -> DistanceSamples:
        """Points with true distances; the near ones lie around the extracted surface."""
        surface, _ = sample_mesh_surface(self.surface(), max(count // 2, 1), generator)
        points = ambient_points(surface, count, generator, working_box(self.dim) if bounds is None else bounds)
        return DistanceSamples(points, self.true_distance(points))

    def true_distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Signed distance to the surface (n,) at x (n, d) in the box: the field itself, unless it is none far away."""
        return evaluate(self, x)

    def _resolution(self, standard: dict[int, int]) -> int:
        """Cells along the longest side of the field's own box."""
        return standard[self.dim]

    @torch.no_grad()
    def _own_field(self, p: Tensor) -> Tensor:
        return self.own_distance(p)

    @torch.no_grad()
    def _onto_surface(self, p: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Points of an extracted surface moved to the zero level by one Newton step, by at most half a cell."""
        return newton_to_level(self.own_jet, p, steps=1, reach=self._own_cell() / 2)[0]

    def _own_cell(self) -> float:
        """Edge of the cells on which the surface is extracted, in own coordinates."""
        low, high = self.own_box()
        return float((high - low).max()) / self._resolution(SURFACE_RESOLUTION)
