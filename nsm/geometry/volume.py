"""The volume (area in 2D) enclosed by the zero level set of a field."""

from __future__ import annotations

from itertools import product
from math import factorial

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nsm.geometry.band import BLOCK, Band, Window, sample_band
from nsm.geometry.grid import Lattice, evaluate
from nsm.geometry.topology import enclosed_volume, simplex_normals
from nsm.types import SignedDistance, SimplexMesh

#: Default number of cells along the longest edge of a box for the volume of a morph.
VOLUME_RESOLUTION = 96
#: Smallest component of a gradient relative to its largest, which keeps `cell_fraction` away from 0/0. Such a tilt does
#: not change volume: a plane that rotates about the center of a cell gains on one side what it loses on the other.
_MIN_TILT = 1e-4
#: Maximum number of simplices at which the slope of a field is measured, and the offset relative to their size.
_SLOPE_SAMPLES, _SLOPE_OFFSET = 128, 0.5


def volume(field: SignedDistance, bounds: Float[Tensor, "2 d"], resolution: int = VOLUME_RESOLUTION) -> float:
    """Compute the volume of {f < 0} in a box (area in 2D).

    Every cell cut by the surface contributes the exact fraction on the inner side of a plane,
    {x : f_mean + ∇f·(x − c) < 0}. The gradient comes from central differences, and the mean of f over the cell,
    f_mean = f(c) + Σ h_i²/24 ∂_i² f, replaces its value at the center c, so that the plane cuts off the same volume as
    the surface to first order in curvature. The error is O(h⁴) for smooth surfaces and O(h²) for surfaces with edges.
    Only the zero level set matters: f need not be a distance.

    Args:
        field: A field f that maps points, shape (n, d), to values, shape (n,), negative inside.
        bounds: Corners of the box, shape (2, d).
        resolution: Number of cells along the longest edge of the box.

    Returns:
        The volume in the units of ``bounds`` to the power d.

    Example:
        >>> import torch
        >>> from nsm.geometry.volume import volume
        >>> box = torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
        >>> round(volume(lambda x: x.norm(dim=1) - 0.5, box, resolution=64), 4)  # 4/3 π r³
        0.5236
    """
    return volume_in_band(sample_band(field, Lattice.centers(bounds, resolution)))


def volume_in_band(band: Band, level: float = 0.0) -> float:
    """Compute the volume of {f < level} from a band of samples at the centers of cells that reaches the level."""
    outside = (band.slot < 0) & (band.far < level)
    cells = float((outside * _points_of_blocks(band)).sum())
    for window, core in band.bricks(before=1, after=1):
        cells += _cells_inside(window.values.double() - level, window, core)
    return cells * float(band.lattice.step.double().prod())


def _cells_inside(values: Tensor, window: Window, core: tuple[slice, ...]) -> float:
    """Count the sampled cells of a brick that are inside, with fractions for those that the surface cuts."""
    inner, mean, gradients = window.known.clone(), values.clone(), []
    for axis, n in enumerate(values.shape):
        before, after = _neighbors(values, axis)
        known_before, known_after = _neighbors(window.known, axis)
        inner &= known_before & known_after
        mean += (before - 2 * values + after) / 24
        # neighbors outside the box repeat the outermost value, so the difference spans one cell instead of two
        span = torch.full((n,), 2.0 if n > 1 else torch.inf, dtype=values.dtype, device=values.device)
        span[[0, -1]] -= 1
        gradients.append((after - before) / span.view([-1 if i == axis else 1 for i in range(values.ndim)]))
    inner, known = inner[core], window.known[core]
    cut = cell_fraction(mean[core][inner], torch.stack([g[core][inner] for g in gradients], 1))
    return float(cut.sum() + (known & ~inner & (values[core] < 0)).sum())


def _points_of_blocks(band: Band) -> Int[Tensor, " *blocks"]:
    """Count the points of the lattice in each block; the last blocks contain fewer."""
    points = torch.ones_like(band.slot)
    for axis, (n, blocks) in enumerate(zip(band.lattice.shape, band.slot.shape, strict=True)):
        held = (n - BLOCK * torch.arange(blocks, device=points.device)).clamp(max=BLOCK)
        points *= held.view([-1 if i == axis else 1 for i in range(points.ndim)])
    return points


def volume_in_surface(mesh: SimplexMesh, field: SignedDistance) -> float:
    """Compute the volume inside a closed mesh of {f = 0}, corrected for the discretization error of the mesh.

    Flat simplices deviate from the surface by f/‖∇f‖. With the values of f at the center c and the vertices v of a
    simplex T, Simpson's rule, which is exact for quadratic f, gives

        V = ∫ x·n / d − Σ_T |T| (d f(c) + Σ_v f(v) / d) / ((d + 1) ‖∇f‖),

    where ‖∇f‖ is the mean of difference quotients across a sample of the simplices. Unlike `volume`, this needs only
    one sample across each part of the shape, so that it also measures thin parts.

    Args:
        mesh: Closed surface of {f = 0} from `nsm.geometry.meshing.extract_surface`.
        field: The field f, which maps points, shape (n, d), to values, shape (n,), negative inside.

    Returns:
        The volume in the units of the mesh to the power d.
    """
    if not len(mesh.simplices):
        return 0.0
    d = mesh.vertices.shape[1]
    middles = mesh.vertices[mesh.simplices].mean(1)
    normals = simplex_normals(mesh)
    sizes = normals.norm(dim=1)
    some = slice(None, None, -(-len(middles) // _SLOPE_SAMPLES))
    across = _SLOPE_OFFSET * float(sizes.mean()) ** (1 / (d - 1)) * torch.nn.functional.normalize(normals[some], dim=1)
    outer, inner = evaluate(field, middles[some] + across), evaluate(field, middles[some] - across)
    slope = (outer - inner).double().sum() / (2 * across.double().norm(dim=1).sum())
    at_vertices = evaluate(field, mesh.vertices).double()[mesh.simplices].sum(1)
    missed = (d * evaluate(field, middles).double() + at_vertices / d) / (d + 1) / slope
    exact = SimplexMesh(mesh.vertices.double(), mesh.simplices)
    return enclosed_volume(exact) - float((sizes.double() * missed).sum())


def volume_with_error(
    field: SignedDistance, bounds: Float[Tensor, "2 d"], resolution: int = VOLUME_RESOLUTION
) -> tuple[float, float]:
    """Compute the volume of {f < 0} in a box, and estimate its error from a grid with cells twice as large.

    With the volumes V_h and V_2h on cells of size h and 2h (`volume`), Richardson's estimate for second order is

        error = |V_h − V_2h| / 3.

    It is accurate for shapes with edges, and five times too large for smooth shapes, where the order is 4. The volume
    returned is V_h without extrapolation: the errors depend on the position of the surface in its cells, and
    extrapolation would add a part of the error of the coarse grid (on balls, it doubles the error).

    Args:
        field: A field f that maps points, shape (n, d), to values, shape (n,), negative inside.
        bounds: Corners of the box, shape (2, d).
        resolution: Number of cells along the longest edge of the box on the finer grid, at least 2.

    Returns:
        The volume and its error, both in the units of ``bounds`` to the power d.
    """
    fine, coarse = volume(field, bounds, resolution), volume(field, bounds, resolution // 2)
    return fine, abs(fine - coarse) / 3


def cell_fraction(mean: Float[Tensor, " n"], rise: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """Compute the fraction of a unit cube in which a linear function is negative.

    With a_i = |rise_i| and α = Σ a_i / 2 − mean, the fraction in which Σ a_i u_i < α is, by inclusion-exclusion over
    the corners s ∈ {0, 1}^d,

        1 / (d! Π a_i) Σ_s (−1)^|s| max(0, α − s·a)^d.

    Args:
        mean: Value at the center of each cube, shape (n,).
        rise: Increase of the function along each edge, shape (n, d).

    Returns:
        Fractions in [0, 1], shape (n,).

    Example:
        >>> import torch
        >>> from nsm.geometry.volume import cell_fraction
        >>> cell_fraction(torch.tensor([0.0, -0.5]), torch.tensor([[1.0, 1.0], [1.0, 1.0]]))
        tensor([0.5000, 0.8750])
    """
    dim = rise.shape[1]
    slope = rise.abs()
    scale = slope.amax(1, keepdim=True).clamp(min=torch.finfo(rise.dtype).tiny)
    slope = (slope / scale).clamp(min=_MIN_TILT)
    level = slope.sum(1) / 2 - mean / scale[:, 0]
    total = torch.zeros_like(level)
    for corner in product((0, 1), repeat=dim):
        beyond = level - slope @ slope.new_tensor(corner)
        total += (-1) ** sum(corner) * beyond.clamp(min=0) ** dim
    fraction = total / (factorial(dim) * slope.prod(1))
    # far from the plane the terms are large and cancel, but the fraction is known
    fraction = torch.where(level >= slope.sum(1), 1.0, fraction)
    return fraction.clamp(0, 1)


def _neighbors(values: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    """Shift values by one backward and forward along an axis, repeating the outermost."""
    n = values.shape[axis]
    first, last = values.narrow(axis, 0, 1), values.narrow(axis, n - 1, 1)
    before = torch.cat([first, values.narrow(axis, 0, n - 1)], axis)
    after = torch.cat([values.narrow(axis, 1, n - 1), last], axis)
    return before, after
