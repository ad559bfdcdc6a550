"""Shapes in normalized coordinates, with distances that are fast to read, for registration."""

from __future__ import annotations

from math import prod

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.geometry.grid import Lattice
from nsm.geometry.sampling import sample_mesh
from nsm.geometry.topology import simplex_areas
from nsm.shapes.base import FieldShape
from nsm.shapes.similarity import Similarity
from nsm.types import SimplexMesh

#: Cells of the lattice along the longest side of a shape with its margins, by dimension.
_CELLS = {2: 64, 3: 16}
#: Margin of the lattice, as a share of the longest side of the shape.
_MARGIN = 0.5


class NormalizedShape:
    """A shape in normalized coordinates, in which its surface has its centroid at the origin and mean square radius 1.

    Args:
        shape: The shape.
        count: Number of points drawn on its surface.
        generator: Draws the points.

    Attributes:
        normalizing: Similarity from the local coordinates of the shape to the normalized ones.
        points: Points on the surface, drawn by area, shape (n, d).
        side: Longest side of the bounding box, in normalized coordinates.
    """

    def __init__(self, shape: FieldShape, count: int, generator: torch.Generator) -> None:
        self.shape = shape
        mesh = shape.local_surface()
        vertices = mesh.vertices.double()
        corners = vertices[mesh.simplices]
        areas = simplex_areas(corners)
        center = (areas[:, None] * corners.mean(1)).sum(0) / areas.sum()
        drawn, _ = sample_mesh(SimplexMesh(vertices - center, mesh.simplices), count, generator)
        scale = 1 / float(drawn.square().sum(1).mean().sqrt())
        self.normalizing = Similarity.scaling(scale, shape.dim).after(Similarity.shift(-center))
        self.points = self._onto_surface(scale * drawn)
        box = self.normalizing.apply(torch.stack([vertices.amin(0), vertices.amax(0)]))
        self.side = float((box[1] - box[0]).max())
        margin = _MARGIN * self.side
        self._lattice = Lattice.corners(box + margin * torch.tensor([[-1.0], [1.0]]), _CELLS[shape.dim])
        values, gradients = self.true_distance(self._lattice.points(self._lattice.indices()))
        self._nodes = torch.cat([values[:, None], gradients], 1).float()
        self._strides = torch.tensor([prod(self._lattice.shape[axis:]) for axis in range(1, shape.dim + 1)])

    def true_distance(self, x: Float[Tensor, "*k d"]) -> tuple[Float[Tensor, " *k"], Float[Tensor, "*k d"]]:
        """Signed distance and its gradient."""
        local = self.normalizing.pull_back(x.reshape(-1, x.shape[-1]))
        value, gradient = self.shape.local_jet(local.to(torch.get_default_dtype()))
        return (self.normalizing.scale * value.double()).view(x.shape[:-1]), gradient.double().view(x.shape)

    def _onto_surface(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Points of the extracted surface moved to the zero level of the distance, by one Newton step."""
        value, gradient = self.true_distance(x)
        return x - (value / gradient.square().sum(1).clamp(min=0.5))[:, None] * gradient

    def lattice_distance(self, x: Float[Tensor, "*k d"]) -> tuple[Float[Tensor, " *k"], Float[Tensor, "*k d"]]:
        """The tangent plane to the signed distance at the nearest point of the lattice, and its gradient."""
        origin, step = self._lattice.origin.to(x), self._lattice.step.to(x)
        last = torch.tensor(self._lattice.shape, dtype=x.dtype) - 1
        index = torch.minimum(((x - origin) / step).round().clamp(min=0), last)
        nodes = self._nodes[(index.long() * self._strides).sum(-1)]
        gradient = nodes[..., 1:]
        return nodes[..., 0] + ((x - origin - step * index) * gradient).sum(-1), gradient
