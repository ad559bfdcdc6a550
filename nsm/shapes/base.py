"""What a shape is: something with a surface and an inside, in the box [-1, 1]^d."""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm.errors import InputError
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


def working_box(dim: int) -> Float[Tensor, "2 d"]:
    """The corners of [-1, 1]^d."""
    return torch.tensor([[-1.0] * dim, [1.0] * dim])


class Shape(ABC):
    """A shape in the box: what a config names, whatever it was made from."""

    #: Dimension of the space, 2 or 3.
    dim: int

    @abstractmethod
    def surface_samples(self, count: int, generator: torch.Generator) -> SurfaceSamples:
        """Points drawn on the surface, uniformly by area where the data allow it, with outward unit normals."""

    @abstractmethod
    def distance_samples(
        self, count: int, generator: torch.Generator, bounds: Float[Tensor, "2 d"] | None = None
    ) -> DistanceSamples:
        """Points with signed distances: half uniform in ``bounds`` (the box [-1, 1]^d if None), half near the surface.

        The near ones are surface points plus Gaussian offsets (`nsm.shapes.sampling.NEAR_SIGMAS`).
        """

    @abstractmethod
    def bounds(self) -> Float[Tensor, "2 d"]:
        """Corners of the smallest axis-parallel box that holds the shape, lowest first."""

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

    def require_in_box(self, bounds: Float[Tensor, "2 d"] | None = None) -> None:
        """Raise an `InputError` if the shape, or what of it is known to be in ``bounds``, leaves [-1, 1]^d."""
        low, high = self.bounds() if bounds is None else bounds
        excess = float(torch.cat([-1 - low, high - 1]).max())
        if excess > 1e-6:
            size = float((high - low).max())
            raise InputError(
                f"The {self.provenance()['kind']} leaves the box [-1, 1]^{self.dim} by {excess:.3g} (it spans "
                f"{_corner(low)} to {_corner(high)}): give it another pose.translation"
                + (f", or pose.scale={1.9 / size:.2g} times what it has." if size > 2 else ".")
            )


class FieldShape(nn.Module, Shape):
    """A shape that is itself a signed distance field g, negative inside.

    A field is defined in its own coordinates and carried to the box by ``similarity`` (x ↦ s R x + t), so that
    the field in the box is s g(Rᵀ(x − t)/s). A checkpoint keeps it as ``config()`` and ``state_dict()``.
    """

    similarity: Similarity

    def __init__(self, dim: int, similarity: Similarity) -> None:
        super().__init__()
        self.dim = dim
        self.similarity = similarity
        self._surface: SimplexMesh | None = None

    @abstractmethod
    def forward(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Signed distance (n,) at x (n, d) in the box."""

    @abstractmethod
    def transformed(self, similarity: Similarity) -> FieldShape:
        """The shape moved by a similarity, on top of what it has: x ↦ s g(Rᵀ(x − t)/s)."""

    @abstractmethod
    def config(self) -> dict[str, Any]:
        """A ``_target_`` and its arguments: instantiating it and loading ``state_dict()`` gives this field again."""

    @abstractmethod
    def own_box(self) -> Float[Tensor, "2 d"]:
        """A box in the field's own coordinates, before the similarity, that holds its surface."""

    def jet(self, x: Float[Tensor, "n d"]) -> Jet:
        """Value (n,) and gradient (n, d) at x (n, d), differentiable where the caller records a graph."""
        record = torch.is_grad_enabled() and x.requires_grad
        with torch.enable_grad():
            x = x if record else x.detach().requires_grad_()
            value = self(x)
            (gradient,) = torch.autograd.grad(value.sum(), x, create_graph=record)
        return Jet(value if record else value.detach(), gradient)

    def surface(self) -> SimplexMesh:
        """The surface, extracted once on a grid over the field's own box and carried to the box."""
        if self._surface is None:
            mesh = extract_surface(self._own_field, self.own_box(), SURFACE_RESOLUTION[self.dim])
            if len(mesh.simplices) == 0:
                raise InputError(
                    f"The {self.provenance()['kind']} has no surface in its box: check its size, and pose.scale."
                )
            self._surface = SimplexMesh(self.similarity.apply(mesh.vertices), mesh.simplices)
        return self._surface

    def content_key(self) -> str:
        """SHA-256 of the configuration and the state."""
        digest = hashlib.sha256(json.dumps(self.config(), sort_keys=True).encode())
        for value in self.state_dict().values():
            digest.update(value.cpu().numpy().tobytes())
        return digest.hexdigest()

    def bounds(self) -> Float[Tensor, "2 d"]:
        """Corners of the box around the extracted surface."""
        vertices = self.surface().vertices
        return torch.stack([vertices.amin(0), vertices.amax(0)])

    def volume(self) -> float:
        """Volume of the inside, from sub-voxel fractions on a grid over the field's own box."""
        own = volume(self._own_field, self.own_box(), VOLUME_RESOLUTION[self.dim])
        return self.similarity.scale**self.dim * own

    @torch.no_grad()
    def surface_samples(self, count: int, generator: torch.Generator) -> SurfaceSamples:
        """Points drawn by area on the extracted surface, then moved to the zero level; normals ∇g/|∇g|."""
        drawn, _ = sample_mesh_surface(self.surface(), count, generator)
        points, jet = newton_to_level(self.jet, drawn)
        return SurfaceSamples(points, nn.functional.normalize(jet.gradient, dim=1))

    @torch.no_grad()
    def distance_samples(
        self, count: int, generator: torch.Generator, bounds: Float[Tensor, "2 d"] | None = None
    ) -> DistanceSamples:
        """Points with the values of the field itself."""
        surface = self.surface_samples(max(count // 2, 1), generator).points
        points = ambient_points(surface, count, generator, working_box(self.dim) if bounds is None else bounds)
        return DistanceSamples(points, evaluate(self, points))

    @torch.no_grad()
    def _own_field(self, x: Tensor) -> Tensor:
        """The field in its own coordinates."""
        return self(self.similarity.apply(x)) / self.similarity.scale


def _corner(x: Tensor) -> str:
    return "(" + ", ".join(f"{v:.3g}" for v in x.tolist()) + ")"
