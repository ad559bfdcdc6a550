"""The level of a field whose mesh encloses a given volume."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.grid import Lattice, sample_band
from nsm.geometry.meshing import open_sides, surface_in_band
from nsm.geometry.topology import enclosed_volume, measure
from nsm.types import SignedDistance, SimplexMesh

#: How far from the volume is near enough, relative to it.
_TOLERANCE = 1e-6
#: Steps after which there is no such level; two or three are usual.
_STEPS = 30
#: The longest step, in edges of the box.
_LONGEST = 0.05


def level_of_volume(field: SignedDistance, bounds: Float[Tensor, "2 d"], resolution: int, volume: float) -> float:
    """The level c at which the mesh of {f = c} encloses a volume.

    What is made equal is the volume of the mesh as `nsm.geometry.meshing.extract_surface` gives it at this resolution,
    by the divergence theorem: a mesh of cells of size h loses O(h²) where the surface is curved, and c makes up for
    that as well. The first step is Newton's with dVol/dc = ∫ 1/‖∇f‖ over the surface, about area / typical ‖∇f‖, the
    others are those of the secant method; all levels are read from one band of samples unless they leave it.

    Args:
        field: maps points (n, d) to values (n,), lower inside.
        bounds: corners (2, d) of the box.
        resolution: cells along the longest edge of the box.
        volume: wanted, in the units of ``bounds`` to the power d; kept to 1e-6 of it.

    Returns:
        The level, in the units of f.

    Raises:
        InputError: if the surface leaves the box, and so encloses nothing, or no level encloses that volume.
    """
    lattice = Lattice.corners(bounds, resolution)
    level, reach = 0.0, float(lattice.step.max()) / 4
    band = sample_band(field, lattice, reach)
    longest = _LONGEST * float((bounds[1] - bounds[0]).max()) * band.slope
    before: tuple[float, float] | None = None
    for _ in range(_STEPS):
        mesh = surface_in_band(band, level)
        mesh = SimplexMesh(mesh.vertices.double(), mesh.simplices)
        if sides := open_sides(mesh, bounds):
            raise InputError(
                f"the surface leaves the box by its sides {', '.join(sides)}, so it encloses no volume to be made "
                "exact: give exact_volume=false, or a smaller shape (source.pose.scale and target.pose.scale)"
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
        level += min(max((volume - inside) / rate, -longest), longest)
        if abs(level) > reach:
            reach = 2 * abs(level)
            band = sample_band(field, lattice, reach)
    raise InputError(
        f"no level of the field near 0 encloses the volume {volume:.5g} on {resolution} cells: give a higher "
        "resolution, or exact_volume=false"
    )
