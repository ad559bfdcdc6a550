"""Points inside shapes, the density of points on a grid, and the signed distance that a density implies."""

from __future__ import annotations

from itertools import product

import torch
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.grid import Lattice, evaluate
from nsm.shapes import FieldShape

#: Number of candidates drawn at once.
_DRAWN = 1 << 16
#: Share of its own bounding box below which a shape cannot be filled by rejection sampling.
_LEAST_SHARE = 1e-4
#: Distance from the surface, in widths of the kernel, up to which a density implies the distance.
REACH = 3.0
#: Variance of the hat function of linear weights, in squared cells.
_HAT_VARIANCE = 1 / 6


def points_inside(shape: FieldShape, count: int, seed: int) -> Float[Tensor, "n d"]:
    """Draw points uniformly in {g < 0}: a scrambled Sobol sequence in the bounding box, without the points outside.

    The first m of them are uniform for every m. They are more even than independent points, so that fewer suffice for
    the same density.

    Args:
        shape: Shape with the signed distance g.
        count: Number of points n.
        seed: Seed of the scrambling.

    Returns:
        Points, shape (n, d).

    Raises:
        InputError: If hardly any point of the bounding box lies inside.
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
                f"The {shape.provenance()['kind']} must have an inside to be filled with points, got {found} of "
                f"{drawn} points inside. Try a closed surface, or `method=adadiv`."
            )
    return torch.cat(kept)[:count]


def padded_lattice(bounds: Float[Tensor, "2 d"], resolution: int, kernel: float) -> Lattice:
    """Make the lattice of the corners of cells of a box, padded so that a kernel at its faces lies inside.

    Args:
        bounds: Corners of the box, shape (2, d).
        resolution: Number of cells along its longest edge.
        kernel: Width σ of the kernel, in units of length.
    """
    inner = Lattice.corners(bounds, resolution)
    around = torch.ceil((REACH + 1) * kernel / inner.step)
    shape = tuple(n + 2 * int(m) for n, m in zip(inner.shape, around, strict=True))
    return Lattice(inner.origin - around * inner.step, inner.step, shape)


def histogram(points: Float[Tensor, "n d"], masses: Float[Tensor, " n"], lattice: Lattice) -> Float[Tensor, " *shape"]:
    """Distribute the mass of points to the 2^d lattice points around each, with multilinear weights.

    The total mass is preserved; points beyond the lattice are counted at its boundary.

    Args:
        points: Points, shape (n, d).
        masses: Mass of each, shape (n,).
        lattice: The lattice.

    Returns:
        Mass at each point of the lattice.
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
    """Smooth a `histogram` to a density (mass per volume) in which each point is a Gaussian of width σ = ``kernel``.

    The multilinear weights already smooth with variance h²/6 along each axis, h the width of a cell. The filter adds
    the variance that is missing to σ².
    """
    cells = ((kernel / lattice.step) ** 2 - _HAT_VARIANCE).clamp(min=0).sqrt().tolist()
    smooth = gaussian_filter(mass.cpu().numpy(), cells, mode="constant", truncate=REACH + 1)
    return torch.from_numpy(smooth).to(mass) / lattice.step.prod()


def distance_of_density(relative: Float[Tensor, " *shape"], kernel: float) -> Float[Tensor, " *shape"]:
    """Compute the signed distance from the surface of a shape from its density relative to that of its inside.

    A half space smoothed by a Gaussian of width σ has ρ(s) = Φ(−s/σ) at distance s from its surface, where Φ is the
    standard normal distribution function. Hence s = −σ Φ⁻¹(ρ), clamped to ±`REACH` σ. Near a surface of curvature κ
    the error is of order σ²κ.

    Example:
        >>> distance_of_density(torch.tensor([0.1587, 0.8413]), kernel=0.1)
        tensor([ 0.1000, -0.1000])
    """
    least = torch.special.ndtr(torch.tensor(-REACH, dtype=torch.double)).item()
    return -kernel * torch.special.ndtri(relative.clamp(least, 1 - least))
