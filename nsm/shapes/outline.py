"""Shapes in 2D bounded by polygons."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm.cli.errors import InputError
from nsm.geometry.triangles import Triangles
from nsm.shapes.sampling import unit_normals
from nsm.shapes.similarity import Pose, Similarity
from nsm.shapes.simplices import SimplexShape
from nsm.types import SimplexMesh

#: Distance to a segment, relative to the size of the shape, below which the height above the segment is used, because
#: its gradient is defined on the segment as well.
_ON_SEGMENT = 1e-5
#: Distance to a corner, relative to the segment, below which a closest point counts as the corner.
_AT_CORNER = 1e-9


class OutlineShape(SimplexShape):
    """The exact signed distance to closed polygons, which may bound several components and holes.

    The distance is that to the closest point c of the segments; its sign is that of ⟨p − c, n⟩ with n the normal of the
    segment or, at a corner, the sum of the normals of both.

    Args:
        corners: Number of corners, which are part of the state, in double precision and relative to the center of the
            shape.
        loops: Number of corners of each polygon in order. Outlines are counterclockwise and holes clockwise.
        pose: Map from the coordinates of the file to the box.
        placement: Map from coordinates relative to the center of the shape to the box.
        origin: Origin of the shape, for the provenance.

    Raises:
        InputError: If ``loops`` are not positive numbers with the sum ``corners``.

    References:
        Bærentzen and Aanæs, Signed Distance Computation Using the Angle Weighted Pseudonormal, IEEE Transactions on
        Visualization and Computer Graphics 2005. https://doi.org/10.1109/TVCG.2005.49
    """

    segments: Tensor

    def __init__(
        self,
        corners: int,
        loops: Sequence[int],
        pose: Pose = None,
        placement: Pose = None,
        origin: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(2, Similarity.read(pose, 2), Similarity.read(placement, 2))
        self.loops, self.origin = [int(count) for count in loops], dict(origin or {"kind": "outline"})
        if sum(self.loops) != corners or min(self.loops, default=0) < 1:
            raise InputError(
                f"`loops` must be numbers of corners with the sum {corners}, got {self.loops}. Try [{corners}]."
            )
        self.register_buffer("vertices", torch.zeros(corners, 2, dtype=torch.float64))
        first = np.repeat(np.cumsum([0, *self.loops[:-1]]), self.loops)
        own = np.arange(corners) - first
        following = first + (own + 1) % np.repeat(self.loops, self.loops)
        self.register_buffer("segments", torch.from_numpy(np.stack([np.arange(corners), following], 1)))
        self._search: Triangles | None = None

    def local_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Evaluate the signed distance; the result can be differentiated once."""
        x = p.double()
        with torch.no_grad():
            foot, normal = self._closest(x)
            size = float((self.vertices.amax(0) - self.vertices.amin(0)).max())
            height = ((x - foot) * normal).sum(1)
            on = (x - foot).norm(dim=1) < _ON_SEGMENT * size
        away = torch.where(on[:, None], normal, x - foot).norm(dim=1)
        return torch.where(on, ((x - foot) * normal).sum(1), torch.where(height < 0, -away, away)).to(p)

    def local_surface(self) -> SimplexMesh:
        """Return the polygons."""
        return SimplexMesh(self.vertices, self.segments)

    def volume(self) -> float:
        """Compute the area by the shoelace formula, in which holes are negative."""
        start, end = self.vertices[self.segments].unbind(1)
        own = float((start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]).sum()) / 2
        return self.placement.scale**2 * own

    def config(self) -> dict[str, Any]:
        """Return sizes, placement, and origin; the corners are the state."""
        return {
            "_target_": "nsm.shapes.OutlineShape",
            "corners": len(self.vertices),
            "loops": self.loops,
            "pose": self.similarity.to_config(),
            "placement": self.placement.to_config(),
            "origin": self.origin,
        }

    def content_key(self) -> str:
        """Hash the polygons and their placement with SHA-256, independently of the file."""
        digest = hashlib.sha256(json.dumps([self.loops, self.placement.to_config()]).encode())
        digest.update(self.vertices.cpu().numpy().tobytes())
        return digest.hexdigest()

    def _closest(self, x: Float[Tensor, "n d"]) -> tuple[Tensor, Tensor]:
        """Find closest points, shape (n, 2), and unit pseudonormals at them, shape (n, 2), which determine the sign."""
        if self._search is None:
            corners, (start, end) = self.vertices.double().cpu().numpy(), self.segments.cpu().numpy().T
            # a segment is a triangle without area, whose search tree is that of triangles in space
            flat = np.concatenate([corners, np.zeros((len(corners), 1))], 1)
            self._search = Triangles(flat, np.stack([start, end, end], 1))
        closest = self._search.closest(nn.functional.pad(x, (0, 1)))
        foot, chosen = closest.points[:, :2], closest.simplices
        ends = self.vertices.to(x)[self.segments]
        normals = unit_normals(ends)
        before = torch.empty_like(self.segments[:, 0])
        before[self.segments[:, 1]] = self.segments[:, 0]  # the segment that ends where each begins
        along = ends[:, 1] - ends[:, 0]
        share = ((foot - ends[chosen, 0]) * along[chosen]).sum(1) / along[chosen].square().sum(1)
        normal = normals[chosen]
        normal = normal + normals[before[chosen]] * (share < _AT_CORNER)[:, None]
        normal = normal + normals[self.segments[chosen, 1]] * (share > 1 - _AT_CORNER)[:, None]
        return foot, nn.functional.normalize(normal, dim=1)

    def _load_from_state_dict(self, *args: Any) -> None:
        super()._load_from_state_dict(*args)
        self.require_simplices()
        self._search = None
