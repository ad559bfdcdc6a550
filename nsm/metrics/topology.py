"""What a morph is made of at each time, and how rough it is."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from nsm.geometry import topology
from nsm.geometry.meshing import extract_surface
from nsm.types import Morph


class SurfaceTopology(NamedTuple):
    """Counts on the surface at one time; no component and a share of 0 where there is no surface."""

    time: float
    #: Every connected component counts, however small: ``largest_share`` tells crumbs from parts.
    components: int
    euler: int
    #: Area (length in 2D) of the largest component, as a share of all.
    largest_share: float
    #: Mean angle in degrees between neighbouring triangles (segments); grows with the size of the cells.
    roughness: float


def surface_topology(morph: Morph, time: float, resolution: int = 96) -> SurfaceTopology:
    """Look at the surface at ``time``, extracted on ``resolution``^d cells of ``morph.bounds``."""
    mesh = extract_surface(partial(morph, t=time), morph.bounds, resolution)
    parts = topology.component_measures(mesh)
    return SurfaceTopology(
        time,
        len(parts),
        topology.euler_number(mesh),
        float(parts[0] / parts.sum()) if len(parts) else 0.0,
        topology.mean_dihedral_angle(mesh),
    )
