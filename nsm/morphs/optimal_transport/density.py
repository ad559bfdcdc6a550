"""Points inside shapes, the density of moving points on a grid, and the distance that a density tells."""

from __future__ import annotations

from itertools import product

import torch
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.grid import Lattice, evaluate
from nsm.shapes import FieldShape

#: Candidates drawn at once.
_DRAWN = 1 << 16
#: A shape that takes up less of its own bounding box than this cannot be filled by trial.
_LEAST_SHARE = 1e-4
#: Widths of the kernel from the surface within which a density tells the distance; beyond, it is taken for this far.
REACH = 3.0
#: Variance of the hat function of linear weights, in squared cells.
_HAT_VARIANCE = 1 / 6


def points_inside(shape: FieldShape, count: int, seed: int) -> Float[Tensor, "n d"]:
    """Points uniform in {g < 0}: a scrambled Sobol sequence in the shape's bounding box, less what lies outside.

    Any first part of them is uniform too, and both are more even than independent points: their density shows the
    shape with fewer of them.

    Raises:
        InputError: if next to nothing of the box is inside.
    """
    low, high = shape.bounds()
    sequence = torch.quasirandom.SobolEngine(shape.dim, scramble=True, seed=seed)
    kept: list[Tensor] = []
    found = drawn = 0
    while found < count:
        candidates = low + (high - low) * sequence.draw(_DRAWN).to(low)
        kept.append(candidates[evaluate(shape, candidates) < 0])
        found, drawn = found + len(kept[-1]), drawn + _DRAWN
        if found < _LEAST_SHARE * drawn:
            raise InputError(
                f"of {drawn} points around the {shape.provenance()['kind']} {found} lie inside, too few to fill it: "
                "give a shape with an inside"
            )
    return torch.cat(kept)[:count]


def padded_lattice(bounds: Float[Tensor, "2 d"], resolution: int, kernel: float) -> Lattice:
    """Corners of the cells of a box, with enough cells around it that a kernel at its faces loses nothing."""
    inner = Lattice.corners(bounds, resolution)
    around = torch.ceil((REACH + 1) * kernel / inner.step)
    shape = tuple(n + 2 * int(m) for n, m in zip(inner.shape, around, strict=True))
    return Lattice(inner.origin - around * inner.step, inner.step, shape)


def histogram(points: Float[Tensor, "n d"], masses: Float[Tensor, " n"], lattice: Lattice) -> Float[Tensor, " *shape"]:
    """Mass at each point of a lattice; every point gives to the 2^d around it with linear weights, and nothing is lost.

    Points beyond the lattice are counted at its rim.
    """
    last = torch.tensor(lattice.shape, device=points.device) - 1
    place = ((points - lattice.origin) / lattice.step).clamp(min=0).minimum(last.to(points))
    base = place.floor().long().minimum(last - 1)
    share = place - base
    strides = torch.tensor([*torch.tensor(lattice.shape[1:]).flip(0).cumprod(0).flip(0).tolist(), 1]).to(last)
    total = torch.zeros(int((last + 1).prod()), dtype=points.dtype, device=points.device)
    for corner in product((0, 1), repeat=len(last)):
        chosen = torch.tensor(corner, device=points.device)
        weight = torch.where(chosen == 1, share, 1 - share).prod(1)
        total.index_add_(0, ((base + chosen) * strides).sum(1), weight * masses)
    return total.view(lattice.shape)


def kernel_density(mass: Float[Tensor, " *shape"], lattice: Lattice, kernel: float) -> Float[Tensor, " *shape"]:
    """Density (mass per volume) of a `histogram`, smoothed so that each point becomes a Gaussian of width ``kernel``.

    The linear weights have smoothed with h²/6 along each axis already; the filter adds what is missing to kernel².
    """
    cells = ((kernel / lattice.step) ** 2 - _HAT_VARIANCE).clamp(min=0).sqrt().tolist()
    smooth = gaussian_filter(mass.cpu().numpy(), cells, mode="constant", truncate=REACH + 1)
    return torch.from_numpy(smooth).to(mass) / lattice.step.prod()


def distance_of_density(relative: Float[Tensor, " *shape"], kernel: float) -> Float[Tensor, " *shape"]:
    """Signed distance from the surface of a shape, from its density relative to that of its inside.

    A half space smoothed by a Gaussian of width σ has ρ(s) = Φ(−s/σ) at the distance s from its surface, Φ the normal
    distribution; so s = −σ Φ⁻¹(ρ), which is cut off at ±`REACH` σ. Near a surface of curvature κ it is right up to
    terms of order σ²κ.
    """
    least = torch.special.ndtr(torch.tensor(-REACH, dtype=torch.double)).item()
    return -kernel * torch.special.ndtri(relative.clamp(least, 1 - least))
