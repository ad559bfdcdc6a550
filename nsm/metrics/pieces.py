"""Components of a surface that are large enough to be seen, and those beyond the expected number."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nsm.geometry.distance import closest_points
from nsm.geometry.topology import component_labels, component_volumes, simplex_normals
from nsm.types import SimplexMesh

#: Volume of a component, relative to that of the largest, up to which it is too small to be seen.
LEAST_SHARE = 1e-5


class Leftover(NamedTuple):
    """Pieces of a surface beyond the number that a shape has.

    Attributes:
        share: Their volume, relative to that of the other pieces.
        distance: Root mean square, over the whole surface, of the distance to the other pieces: sqrt(Σ A_i d_i² / A)
            with the areas A_i of the leftover pieces and their distances d_i. A mean would hide a speck, whose area is
            small.
    """

    share: float
    distance: float


class Pieces(NamedTuple):
    """The connected components of a surface, largest first.

    Attributes:
        mesh: The surface.
        volumes: Volume that each component encloses (area in 2D), also that of a cavity, shape (c,).
        ranks: Rank by volume of the component of each simplex, shape (m,).
    """

    mesh: SimplexMesh
    volumes: Float[Tensor, " c"]
    ranks: Int[Tensor, " m"]

    @classmethod
    def of(cls, mesh: SimplexMesh) -> Pieces:
        """Split a surface into its components."""
        volumes, order = component_volumes(mesh).abs().sort(descending=True)
        return cls(mesh, volumes, order.argsort()[component_labels(mesh)])

    @property
    def components(self) -> int:
        """Number of components that are large enough to be seen (`LEAST_SHARE`)."""
        return int((self.volumes > LEAST_SHARE * self.volumes[0]).sum()) if len(self.volumes) else 0

    def beyond(self, expected: int) -> Leftover:
        """Measure what remains besides the ``expected`` largest components; zero where there are no more than these."""
        if not 0 < expected < self.components:
            return Leftover(0.0, 0.0)
        kept = self.ranks < expected
        spare = ~kept & (self.ranks < self.components)
        areas = simplex_normals(self.mesh).norm(dim=1)
        midpoints = self.mesh.vertices[self.mesh.simplices[spare]].mean(1)
        away = closest_points(midpoints, SimplexMesh(self.mesh.vertices, self.mesh.simplices[kept])).distances
        squared = (areas[spare] * away.square()).sum() / areas.sum()
        share = self.volumes[expected : self.components].sum() / self.volumes[:expected].sum()
        return Leftover(float(share), float(torch.sqrt(squared)))
