"""The level of a field whose mesh encloses a given volume."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.band import sample_band
from nsm.geometry.grid import Lattice
from nsm.geometry.meshing import open_sides, surface_in_band
from nsm.geometry.topology import enclosed_volume, measure
from nsm.types import SignedDistance, SimplexMesh

#: Relative volume error at which the iteration stops.
_TOLERANCE = 1e-6
#: Maximum number of steps; two or three are usual.
_MAX_STEPS = 30
#: Maximum displacement of the surface in one step, relative to the longest edge of the box.
_MAX_STEP = 0.05


def level_of_volume(field: SignedDistance, bounds: Float[Tensor, "2 d"], resolution: int, volume: float) -> float:
    """Find the level c at which the mesh of {f = c} encloses a given volume, to a relative error of 1e-6.

    The volume is that of the mesh from `nsm.geometry.meshing.extract_surface` at this resolution, by the divergence
    theorem. A mesh with cells of size h loses O(h²) of the volume where the surface is curved, and the level
    compensates for this as well. The first step is Newton's, with dVol/dc = ∫ 1/‖∇f‖ over the surface approximated by
    area / typical ‖∇f‖; the others are secant steps. One band of samples serves all levels that lie within its reach.

    Args:
        field: A field that maps points, shape (n, d), to values, shape (n,), lower inside.
        bounds: Corners of the box, shape (2, d).
        resolution: Number of cells along the longest edge of the box.
        volume: Volume to enclose, in the units of ``bounds`` to the power d.

    Returns:
        The level, in the units of f.

    Raises:
        InputError: If the surface leaves the box, so that the mesh is open, or no level encloses that volume.

    Example:
        >>> import torch
        >>> from nsm.geometry.level import level_of_volume
        >>> box = torch.tensor([[-1.0, -1.0], [1.0, 1.0]])
        >>> disk = lambda x: x.norm(dim=1) - 0.5
        >>> round(level_of_volume(disk, box, resolution=64, volume=torch.pi * 0.6**2), 2)
        0.1
    """
    lattice = Lattice.corners(bounds, resolution)
    level, reach = 0.0, float(lattice.step.max()) / 4
    band = sample_band(field, lattice, reach)
    max_step = _MAX_STEP * float((bounds[1] - bounds[0]).max()) * band.slope
    before: tuple[float, float] | None = None
    for _ in range(_MAX_STEPS):
        mesh = surface_in_band(band, level)
        mesh = SimplexMesh(mesh.vertices.double(), mesh.simplices)
        if sides := open_sides(mesh, bounds):
            raise InputError(
                "`bounds` must contain the surface for an exact volume, got a surface that leaves the box at "
                f"{', '.join(sides)}. Try `exact_volume=false`, or smaller shapes with `source.pose.scale` and "
                "`target.pose.scale`."
            )
        inside = enclosed_volume(mesh)
        if abs(inside - volume) <= _TOLERANCE * volume:
            return level
        rate = measure(mesh) / band.slope
        if before is not None and (inside - before[1]) * (level - before[0]) > 0:
            rate = (inside - before[1]) / (level - before[0])
        if not rate:
            break
        before = level, inside
        level += min(max((volume - inside) / rate, -max_step), max_step)
        if abs(level) > reach:
            reach = 2 * abs(level)
            band = sample_band(field, lattice, reach)
    raise InputError(
        f"`resolution` must be high enough for a level that encloses the volume {volume:.5g}, got {resolution}. Try "
        f"`resolution={2 * resolution}`, or `exact_volume=false`."
    )
