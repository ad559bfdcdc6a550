"""The volume (area in 2D) inside the zero set of a field, from fractions of cells."""

from __future__ import annotations

from itertools import product
from math import factorial

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nsm.geometry.grid import BLOCK, Band, Lattice, Window, evaluate, sample_band
from nsm.geometry.topology import enclosed_volume, simplex_normals
from nsm.types import SignedDistance, SimplexMesh

#: Least component of a gradient relative to its largest: keeps the cut formula away from 0/0. A tilt this small
#: moves no volume, as a plane that turns about the middle of a cell takes on one side what it gives on the other.
_LEAST_TILT = 1e-4
#: Simplices at which the slope of a field across a mesh is measured, at most, and over which part of their size.
_SLOPES, _ACROSS = 128, 0.5


def volume(field: SignedDistance, bounds: Float[Tensor, "2 d"], resolution: int = 96) -> float:
    """Volume of {f < 0} within a box.

    Every cell that the surface cuts contributes the exact part of it below a plane, {f_mean + ∇f·(x - c) < 0}, with
    ∇f from central differences and the mean of f over the cell, f_mean = f(c) + Σ h_i²/24 ∂_i² f, in place of its
    value at the middle: to first order in the curvature of the surface, the plane then takes as much as the surface
    does. For smooth surfaces the error falls as h⁴, for those with edges as h². Only the zero set of f counts, so f
    need not be a distance.

    Args:
        field: maps points (n, d) to values (n,), negative inside.
        bounds: corners (2, d) of the box.
        resolution: cells along the longest edge of the box.

    Returns:
        The volume in the units of ``bounds`` to the power d.
    """
    return volume_in_band(sample_band(field, Lattice.centres(bounds, resolution)))


def volume_in_band(band: Band, level: float = 0.0) -> float:
    """Volume of {f < level}, from samples of f at the middles of cells, in a band that reaches to the level."""
    outside = (band.slot < 0) & (band.far < level)
    cells = float((outside * _points_of_blocks(band)).sum())
    for window, core in band.bricks(before=1, after=1):
        cells += _cells_inside(window.values.double() - level, window, core)
    return cells * float(band.lattice.step.double().prod())


def _cells_inside(values: Tensor, window: Window, core: tuple[slice, ...]) -> float:
    """How many of the sampled cells of a brick are inside, in fractions."""
    inner, mean, gradients = window.known.clone(), values.clone(), []
    for axis, n in enumerate(values.shape):
        before, after = _neighbours(values, axis)
        known_before, known_after = _neighbours(window.known, axis)
        inner &= known_before & known_after
        mean += (before - 2 * values + after) / 24
        # neighbours beyond the box repeat the outermost value: there the difference spans one cell, not two
        span = torch.full((n,), 2.0 if n > 1 else torch.inf, dtype=values.dtype, device=values.device)
        span[[0, -1]] -= 1
        gradients.append((after - before) / span.view([-1 if i == axis else 1 for i in range(values.ndim)]))
    inner, known = inner[core], window.known[core]
    cut = cell_fraction(mean[core][inner], torch.stack([g[core][inner] for g in gradients], 1))
    return float(cut.sum() + (known & ~inner & (values[core] < 0)).sum())


def _points_of_blocks(band: Band) -> Int[Tensor, " *blocks"]:
    """How many points of the lattice each block holds: fewer at the end."""
    points = torch.ones_like(band.slot)
    for axis, (n, blocks) in enumerate(zip(band.lattice.shape, band.slot.shape, strict=True)):
        held = (n - BLOCK * torch.arange(blocks, device=points.device)).clamp(max=BLOCK)
        points *= held.view([-1 if i == axis else 1 for i in range(points.ndim)])
    return points


def volume_in_surface(mesh: SimplexMesh, field: SignedDistance) -> float:
    """Volume inside a closed mesh that was extracted from a field, corrected for the error of the mesh.

    Flat simplices between points next to the surface miss it by f/‖∇f‖. With the value of f in the middle c and at the
    vertices v of a simplex T, Simpson's rule, exact for quadratic f, gives

        V = ∫ x·n / d − Σ |T| (d f(c) + Σ f(v) / d) / ((d + 1) ‖∇f‖),

    with the mean of ‖∇f‖ over a part of the simplices, from differences across them. Unlike `volume`, this needs no
    more than one sample across a part of the shape, so it measures thin ones as well.

    Args:
        mesh: Closed surface of {f = 0}, as `nsm.geometry.meshing.extract_surface` gives it.
        field: f, maps points (n, d) to values (n,), negative inside.
    """
    if not len(mesh.simplices):
        return 0.0
    d = mesh.vertices.shape[1]
    middles = mesh.vertices[mesh.simplices].mean(1)
    normals = simplex_normals(mesh)
    sizes = normals.norm(dim=1)
    some = slice(None, None, -(-len(middles) // _SLOPES))
    across = _ACROSS * float(sizes.mean()) ** (1 / (d - 1)) * torch.nn.functional.normalize(normals[some], dim=1)
    outer, inner = evaluate(field, middles[some] + across), evaluate(field, middles[some] - across)
    slope = (outer - inner).double().sum() / (2 * across.double().norm(dim=1).sum())
    at_vertices = evaluate(field, mesh.vertices).double()[mesh.simplices].sum(1)
    missed = (d * evaluate(field, middles).double() + at_vertices / d) / (d + 1) / slope
    exact = SimplexMesh(mesh.vertices.double(), mesh.simplices)
    return enclosed_volume(exact) - float((sizes.double() * missed).sum())


def volume_with_error(field: SignedDistance, bounds: Float[Tensor, "2 d"], resolution: int = 96) -> tuple[float, float]:
    """Volume of {f < 0} within a box, and an estimate of what it is off by, from a second grid of cells twice the size.

    With the volumes V_h and V_2h on cells of size h and 2h (`volume`), Richardson's estimate for second order is

        error = |V_h - V_2h| / 3,

    about right for shapes with edges and five times too large for smooth ones, where the order is 4. V_h itself is what
    is returned: what is left of either error wanders with the place of the surface in its cells, and an extrapolation
    would add a part of that of the coarse grid (measured on balls, it doubles the error).

    Args:
        field: maps points (n, d) to values (n,), negative inside.
        bounds: corners (2, d) of the box.
        resolution: cells along the longest edge of the box, of the finer of the two grids; at least 2.

    Returns:
        The volume and the error, both in the units of ``bounds`` to the power d.
    """
    fine, coarse = volume(field, bounds, resolution), volume(field, bounds, resolution // 2)
    return fine, abs(fine - coarse) / 3


def cell_fraction(mean: Float[Tensor, " n"], rise: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """Part of a unit cube where a linear function is negative.

    With a_i = |rise_i| and α = Σ a_i / 2 - mean, the part of the cube where Σ a_i u_i < α is, by inclusion and
    exclusion of the corners s ∈ {0, 1}^d,

        1 / (d! Π a_i) Σ_s (-1)^|s| max(0, α - s·a)^d.

    Args:
        mean: value (n,) in the middle of the cube.
        rise: how much the function grows along each edge (n, d).

    Returns:
        Fractions (n,) in [0, 1].
    """
    dim = rise.shape[1]
    slope = rise.abs()
    scale = slope.amax(1, keepdim=True).clamp(min=torch.finfo(rise.dtype).tiny)
    slope = (slope / scale).clamp(min=_LEAST_TILT)
    level = slope.sum(1) / 2 - mean / scale[:, 0]
    total = torch.zeros_like(level)
    for corner in product((0, 1), repeat=dim):
        beyond = level - slope @ slope.new_tensor(corner)
        total += (-1) ** sum(corner) * beyond.clamp(min=0) ** dim
    fraction = total / (factorial(dim) * slope.prod(1))
    # far from the plane the terms are large and cancel: there the answer is known
    fraction = torch.where(level >= slope.sum(1), 1.0, fraction)
    return fraction.clamp(0, 1)


def _neighbours(values: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    """Values one step back and one step on along an axis, the outermost repeated."""
    n = values.shape[axis]
    first, last = values.narrow(axis, 0, 1), values.narrow(axis, n - 1, 1)
    before = torch.cat([first, values.narrow(axis, 0, n - 1)], axis)
    after = torch.cat([values.narrow(axis, 1, n - 1), last], axis)
    return before, after
