"""What shapes that are bounded by simplices share: triangle meshes in 3D and polygons in 2D."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.sampling import sample_mesh
from nsm.shapes.base import FieldShape
from nsm.shapes.sampling import unit_normals
from nsm.types import SimplexMesh, SurfaceSamples

#: Margin around the vertices in the local box, relative to the size of the shape.
_MARGIN = 0.05


class SimplexShape(FieldShape):
    """A shape whose boundary is known as simplices, triangles or segments, and need not be extracted.

    Attributes:
        vertices: Vertices in double precision relative to the center of the shape, shape (v, d).
        origin: Origin of the shape, for the provenance.
    """

    vertices: Tensor
    origin: dict[str, Any]

    @abstractmethod
    def local_surface(self) -> SimplexMesh:
        """Return the simplices themselves, in local coordinates."""

    def require_simplices(self) -> None:
        """Require finite vertices and simplices that index them, as search trees end the process with other ones.

        Raises:
            InputError: If there are none, or some are not so.
        """
        vertices, simplices = self.local_surface()
        indices = simplices.aminmax() if len(simplices) else None
        if indices is None or indices.min < 0 or indices.max >= len(vertices) or not vertices.isfinite().all():
            raise InputError(
                f"`simplices` must join finite vertices that exist, got {len(simplices)} of {len(vertices)} vertices "
                "with others. Try to read the file of the shape again."
            )

    def surface(self) -> SimplexMesh:
        """Return the simplices in the coordinates of the box, in the default precision."""
        local = self.local_surface()
        vertices = self.placement.apply(local.vertices.double()).to(torch.get_default_dtype())
        return SimplexMesh(vertices, local.simplices)

    def local_box(self) -> Float[Tensor, "2 d"]:
        """Return the bounding box with a margin."""
        low, high = self.vertices.amin(0), self.vertices.amax(0)
        margin = _MARGIN * (high - low).max()
        return torch.stack([low - margin, high + margin])

    def surface_samples(self, count: int, generator: torch.Generator) -> SurfaceSamples:
        """Sample points uniformly on the simplices, with the normals of the simplices."""
        mesh = self.surface()
        points, chosen = sample_mesh(mesh, count, generator)
        return SurfaceSamples(points, unit_normals(mesh.vertices[mesh.simplices[chosen]]))

    def provenance(self) -> dict[str, Any]:
        """Return file, checksum, and the similarity from the coordinates of the file to the box."""
        return {**self.origin, "similarity": self.similarity.to_config()}
