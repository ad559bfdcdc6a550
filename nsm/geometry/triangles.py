"""Repeated queries of distances and winding numbers of one set of triangles."""

from __future__ import annotations

from typing import Any

import igl
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from nsm.geometry.distance import Closest

#: Number of cells along the longest edge of the box around the queries. Queries of one cell are processed
#: consecutively, so that their part of the search tree stays in the cache, which is 1.5 times as fast.
_CELLS = 16


class Triangles:
    """Triangles with search trees for closest points and winding numbers, which are built once.

    Args:
        vertices: Vertices in double precision, shape (v, 3).
        faces: Indices of the corners of triangles, shape (m, 3).
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        self.faces = np.ascontiguousarray(faces, dtype=np.int64)
        self._boxes = igl.AABB()
        self._boxes.init(self.vertices, self.faces)
        self._winding: Any = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Rebuild the trees in copies and pickles, because those of libigl cannot be copied."""
        return Triangles, (self.vertices, self.faces)

    def closest(self, x: Float[Tensor, "n 3"]) -> Closest:
        """Find the closest point and its triangle for each of n points, without approximation."""
        queries = x.detach().cpu().double().numpy()
        order = _spatial_order(queries)
        squared, triangles, points = (np.empty_like(a) for a in (queries[:, 0], order, queries))
        if len(order):
            squared[order], triangles[order], points[order] = self._boxes.squared_distance(
                self.vertices, self.faces, np.ascontiguousarray(queries[order])
            )
        return Closest(
            torch.from_numpy(squared).clamp(min=0).sqrt().to(x),
            torch.from_numpy(points).to(x),
            torch.from_numpy(triangles).to(x.device),
        )

    def winding_number(self, x: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Evaluate the winding number, shape (n,): 1 inside and 0 outside a closed surface, and between near holes.

        References:
            Barill et al., Fast Winding Numbers for Soups and Clouds, SIGGRAPH 2018.
            https://doi.org/10.1145/3197517.3201337
        """
        if self._winding is None:
            self._winding = igl.FastWindingNumberBVH()
            self._winding.init(self.vertices, self.faces)
        queries = np.ascontiguousarray(x.detach().cpu().double().numpy())
        return torch.from_numpy(np.asarray(self._winding.winding_number(queries)).reshape(len(queries))).to(x)


def _spatial_order(queries: np.ndarray) -> np.ndarray:
    """Find an order in which nearby queries are consecutive."""
    if not len(queries):
        return np.zeros(0, dtype=np.int64)
    low, extent = queries.min(0), float(np.ptp(queries, axis=0).max()) or 1.0
    cells = np.minimum((queries - low) * (_CELLS / extent), _CELLS - 1).astype(np.int64)
    return np.argsort(cells @ np.array([_CELLS**2, _CELLS, 1]), kind="stable")
