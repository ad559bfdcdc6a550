"""Advection of a surface by a velocity field, with more triangles where the flow bends or stretches it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nsm.geometry.advection import VelocityField, advect
from nsm.geometry.refinement import edges_of, split_edges
from nsm.types import SimplexMesh

#: An edge is split where its advected midpoint is farther from the middle of its advected ends than this, relative to
#: the mean length of the edges of the surface that is advected.
TOLERANCE = 0.05
#: Number of times that edges are split.
ROUNDS = 6
#: Number of bits of the number of a vertex, two of which identify an edge.
_BITS = 31


class AdvectedMesh(NamedTuple):
    """A surface at some times, with k times, and the same surface with the midpoints of all edges as vertices.

    Attributes:
        positions: Vertices at each time, those of the original surface first, shape (k, v, d).
        simplices: Indices of the vertices of each simplex, shape (m, d).
        fine_positions: These vertices, then the midpoints of all edges, as advected, shape (k, w, d).
        fine_simplices: The simplices split at all midpoints, shape (n, d).
    """

    positions: Float[Tensor, "k v d"]
    simplices: Int[Tensor, "m d"]
    fine_positions: Float[Tensor, "k w d"]
    fine_simplices: Int[Tensor, "n d"]


@torch.no_grad()
def advect_mesh(velocity: VelocityField, mesh: SimplexMesh, times: Sequence[float]) -> AdvectedMesh:
    """Advect a surface, and split the edges that are not straight at all times (`TOLERANCE`, `ROUNDS`).

    A flow may stretch a surface so much in places that its triangles no longer follow it. New vertices are midpoints of
    edges at the first time, so the initial surface keeps its shape.

    Args:
        velocity: The velocity V, which maps points, shape (n, d), and one time to velocities, shape (n, d).
        mesh: Surface at the first time.
        times: Increasing times, k of them.

    Example:
        A square of four corners, whose horizontal sides the flow bends.

        >>> corners = torch.tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        >>> square = SimplexMesh(corners, torch.tensor([[0, 1], [1, 2], [2, 3], [3, 0]]))
        >>> bent = advect_mesh(lambda x, t: torch.stack([0 * x[:, 0], x[:, 0] ** 2], 1), square, [0.0, 1.0])
        >>> len(square.simplices), len(bent.simplices)
        (4, 10)
    """
    simplices, positions = mesh.simplices, advect(velocity, mesh.vertices, times)
    edges, _ = edges_of(simplices)
    tolerance = TOLERANCE * float((mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]]).norm(dim=1).mean())
    known, middles = edges.new_empty(0), positions[:, :0]
    for remaining in range(ROUNDS, -1, -1):
        edges, edge_of = edges_of(simplices)
        names = (edges[:, 0] << _BITS) | edges[:, 1]  # in increasing order
        new = ~torch.isin(names, known)
        ends = positions[:, edges]
        moved = torch.empty_like(ends[:, :, 0])
        moved[:, new] = advect(velocity, ends[0, new].mean(1), times)
        moved[:, ~new] = middles[:, torch.isin(known, names)]
        known, middles = names, moved
        bent = (moved - ends.mean(2)).norm(dim=2).amax(0) > tolerance
        if not remaining or not bent.any():
            break
        simplices = split_edges(simplices, _numbered(bent, positions.shape[1])[edge_of])
        positions = torch.cat([positions, moved[:, bent]], 1)
    every = _numbered(torch.ones_like(bent), positions.shape[1])
    return AdvectedMesh(positions, simplices, torch.cat([positions, moved], 1), split_edges(simplices, every[edge_of]))


def _numbered(chosen: Tensor, first: int) -> Int[Tensor, " e"]:
    """Consecutive numbers from ``first`` for the chosen edges, −1 for the others."""
    number = torch.full((len(chosen),), -1, device=chosen.device)
    number[chosen] = first + torch.arange(int(chosen.sum()), device=chosen.device)
    return number
