"""Finer triangles where a surface bends, so that edges are sharp in pictures without a fine grid everywhere."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from nsm.types import SignedDistance, SimplexMesh

#: An edge is cut where the normals at its ends differ by more than this.
_BEND = math.radians(14)
#: Newton steps that take the middle of an edge onto the surface.
_NEWTON_STEPS = 1


def refine_bends(
    mesh: SimplexMesh,
    field: SignedDistance,
    gradient: Callable[[Tensor], Tensor],
    level: float = 0.0,
    rounds: int = 2,
) -> tuple[SimplexMesh, Float[Tensor, "v 3"]]:
    """Cut the edges of triangles across which the surface bends, and put the new vertices onto the surface.

    The middle x of an edge moves by x ← x − (f(x) − level) ∇f/‖∇f‖², at most by half the length of the edge. Triangles
    with one, two or three cut edges become two, three or four, so that no gap opens between neighbours.

    Args:
        mesh: triangles of the level set.
        field: f, maps (n, 3) to (n,).
        gradient: ∇f, maps (n, 3) to (n, 3).
        level: the value of f on the surface.
        rounds: how often edges are halved.

    Returns:
        The finer mesh and the normals ∇f/‖∇f‖ (v, 3) at its vertices.
    """
    vertices, triangles = mesh
    normals = normalize(gradient(vertices), dim=1)
    for _ in range(rounds):
        if not len(triangles):
            break
        edges, edge_of = _edges(triangles)
        start, end = edges.unbind(1)
        cut = (normals[start] * normals[end]).sum(1) < math.cos(_BEND)
        middle = _onto_surface(vertices[start[cut]], vertices[end[cut]], field, gradient, level)
        number = torch.full((len(edges),), -1, device=triangles.device)
        number[cut] = len(vertices) + torch.arange(len(middle), device=triangles.device)
        triangles = _cut(triangles, number[edge_of])
        vertices = torch.cat([vertices, middle])
        normals = torch.cat([normals, normalize(gradient(middle), dim=1)])
    return SimplexMesh(vertices, triangles), normals


def _edges(triangles: Int[Tensor, "m 3"]) -> tuple[Int[Tensor, "e 2"], Int[Tensor, "m 3"]]:
    """All edges once, and for each triangle those opposite its third, first and second corner: 01, 12, 20."""
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
    furthest = (end - start).norm(dim=1, keepdim=True) / 2
    moved = middle
    for _ in range(_NEWTON_STEPS):
        slope = gradient(moved)
        step = (field(moved) - level)[:, None] * slope / slope.square().sum(1, keepdim=True).clamp(min=1e-6)
        moved = moved - step
    away = moved - middle
    length = away.norm(dim=1, keepdim=True).clamp(min=1e-12)
    return middle + away * (furthest / length).clamp(max=1)


def _cut(triangles: Int[Tensor, "m 3"], middles: Int[Tensor, "m 3"]) -> Int[Tensor, "k 3"]:
    """Triangles with new vertices ``middles`` on their edges 01, 12, 20; -1 where an edge stays whole."""
    is_cut = middles >= 0
    count = is_cut.sum(1)
    parts = [triangles[count == 0]]
    # turned so that the only cut edge is 01, or the only whole edge is 20
    for number, wanted in ((1, is_cut), (2, ~is_cut)):
        chosen = count == number
        shift = wanted[chosen].int().argmax(1) + (number == 2)
        (a, b, c), (ab, bc, _) = _turned(triangles[chosen], shift), _turned(middles[chosen], shift)
        if number == 1:
            parts += [_rows(a, ab, c), _rows(ab, b, c)]
        else:
            parts += [_rows(ab, b, bc), _rows(a, ab, bc), _rows(a, bc, c)]
    chosen = count == 3
    (a, b, c), (ab, bc, ca) = triangles[chosen].unbind(1), middles[chosen].unbind(1)
    parts += [_rows(a, ab, ca), _rows(ab, b, bc), _rows(ca, bc, c), _rows(ab, bc, ca)]
    return torch.cat(parts)


def _turned(rows: Int[Tensor, "n 3"], shift: Int[Tensor, " n"]) -> tuple[Tensor, Tensor, Tensor]:
    """Columns of rows turned left, each by its own shift."""
    order = (torch.arange(3, device=rows.device) + shift[:, None]) % 3
    first, second, third = rows.gather(1, order).unbind(1)
    return first, second, third


def _rows(*columns: Int[Tensor, " n"]) -> Int[Tensor, "n 3"]:
    return torch.stack(columns, 1)
