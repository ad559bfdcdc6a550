"""Local refinement of triangles where a surface bends, for sharp edges in pictures without a fine grid everywhere."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from nsm.types import SignedDistance, SimplexMesh

#: An edge is split where the normals at its ends differ by more than this angle.
_BEND = math.radians(14)
#: Number of Newton steps that move the midpoint of an edge onto the surface.
_NEWTON_STEPS = 1


def refine_bends(
    mesh: SimplexMesh,
    field: SignedDistance,
    gradient: Callable[[Tensor], Tensor],
    level: float = 0.0,
    rounds: int = 2,
) -> tuple[SimplexMesh, Float[Tensor, "v 3"]]:
    """Split edges along which the surface bends, and move the new vertices onto the surface.

    The midpoint x of an edge moves by x ← x − (f(x) − c) ∇f/‖∇f‖², by at most half the length of the edge. Triangles
    with one, two, or three split edges become two, three, or four triangles, so that neighbors stay connected.

    Args:
        mesh: Triangles of the level set {f = c}.
        field: The field f, which maps points, shape (n, 3), to values, shape (n,).
        gradient: Its gradient ∇f, which maps points, shape (n, 3), to vectors, shape (n, 3).
        level: The level c.
        rounds: Number of times that edges are split.

    Returns:
        The refined mesh, and the normals ∇f/‖∇f‖ at its vertices, shape (v, 3).
    """
    vertices, triangles = mesh
    normals = normalize(gradient(vertices), dim=1)
    for _ in range(rounds):
        if not len(triangles):
            break
        edges, edge_of = _edges(triangles)
        start, end = edges.unbind(1)
        split = (normals[start] * normals[end]).sum(1) < math.cos(_BEND)
        middle = _onto_surface(vertices[start[split]], vertices[end[split]], field, gradient, level)
        number = torch.full((len(edges),), -1, device=triangles.device)
        number[split] = len(vertices) + torch.arange(len(middle), device=triangles.device)
        triangles = _split(triangles, number[edge_of])
        vertices = torch.cat([vertices, middle])
        normals = torch.cat([normals, normalize(gradient(middle), dim=1)])
    return SimplexMesh(vertices, triangles), normals


def _edges(triangles: Int[Tensor, "m 3"]) -> tuple[Int[Tensor, "e 2"], Int[Tensor, "m 3"]]:
    """List all edges once, and for each triangle the numbers of its edges 01, 12, and 20."""
    pairs = torch.stack([triangles, triangles.roll(-1, 1)], 2).sort(2).values
    edges, edge_of = pairs.view(-1, 2).unique(dim=0, return_inverse=True)
    return edges, edge_of.view(-1, 3)


def _onto_surface(
    start: Float[Tensor, "n 3"],
    end: Float[Tensor, "n 3"],
    field: SignedDistance,
    gradient: Callable[[Tensor], Tensor],
    level: float,
) -> Float[Tensor, "n 3"]:
    middle = (start + end) / 2
    max_distance = (end - start).norm(dim=1, keepdim=True) / 2
    moved = middle
    for _ in range(_NEWTON_STEPS):
        slope = gradient(moved)
        step = (field(moved) - level)[:, None] * slope / slope.square().sum(1, keepdim=True).clamp(min=1e-6)
        moved = moved - step
    displacement = moved - middle
    length = displacement.norm(dim=1, keepdim=True).clamp(min=1e-12)
    return middle + displacement * (max_distance / length).clamp(max=1)


def _split(triangles: Int[Tensor, "m 3"], middles: Int[Tensor, "m 3"]) -> Int[Tensor, "k 3"]:
    """Split triangles at the new vertices ``middles`` of their edges 01, 12, and 20; -1 marks an edge that stays."""
    is_split = middles >= 0
    count = is_split.sum(1)
    parts = [triangles[count == 0]]
    # rotate corners so that the only split edge is 01, or the only unsplit edge is 20
    for number, wanted in ((1, is_split), (2, ~is_split)):
        chosen = count == number
        shift = wanted[chosen].int().argmax(1) + (number == 2)
        (a, b, c), (ab, bc, _) = _rotated(triangles[chosen], shift), _rotated(middles[chosen], shift)
        if number == 1:
            parts += [_rows(a, ab, c), _rows(ab, b, c)]
        else:
            parts += [_rows(ab, b, bc), _rows(a, ab, bc), _rows(a, bc, c)]
    chosen = count == 3
    (a, b, c), (ab, bc, ca) = triangles[chosen].unbind(1), middles[chosen].unbind(1)
    parts += [_rows(a, ab, ca), _rows(ab, b, bc), _rows(ca, bc, c), _rows(ab, bc, ca)]
    return torch.cat(parts)


def _rotated(rows: Int[Tensor, "n 3"], shift: Int[Tensor, " n"]) -> tuple[Tensor, Tensor, Tensor]:
    """Rotate each row to the left by its own shift, and return the columns."""
    order = (torch.arange(3, device=rows.device) + shift[:, None]) % 3
    first, second, third = rows.gather(1, order).unbind(1)
    return first, second, third


def _rows(*columns: Int[Tensor, " n"]) -> Int[Tensor, "n 3"]:
    return torch.stack(columns, 1)
