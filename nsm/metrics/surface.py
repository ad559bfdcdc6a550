"""What the surface of a morph is like at one time: parts and handles, size, roughness, ‖∇f‖, and how it moves."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch

from nsm.geometry import topology
from nsm.geometry.distance import sample_mesh
from nsm.metrics.pieces import Pieces
from nsm.metrics.residuals import divergence, level_set_residual, mean_size, rate
from nsm.types import Morph, SimplexMesh

#: Points drawn on the surface.
SAMPLES = 10_000


class SurfaceFigures(NamedTuple):
    """What holds on the surface at one time; not a number where there is no surface, or no velocity."""

    time: float
    #: Every connected component counts, however small: ``largest_share`` tells crumbs from parts.
    components: int
    #: Connected components that are large enough to be seen (`nsm.metrics.pieces.LEAST_SHARE`).
    pieces: int
    euler: int
    #: Handles, all components together; 0 in 2D. Counts are those of a closed surface: it must not leave the box.
    genus: int
    #: Area (length in 2D) of the largest component, as a share of all; 0 where there is none.
    largest_share: float
    #: Area (3D) or length (2D).
    area: float
    #: Mean angle in degrees between neighbouring triangles (segments); grows with the size of the cells.
    roughness: float
    #: Mean and standard deviation of ‖∇f‖: 1 and 0 for a distance.
    gradient_norm: float
    gradient_norm_std: float
    #: Mean of |∂f/∂t| / ‖∇f‖: how fast the surface moves along its normal.
    speed: float
    #: Mean of |∂f/∂t + ⟨∇f, V⟩| / ‖∇f‖: the speed at which V leaves the surface behind, along the normal.
    level_set: float
    #: Mean of |div V|, per unit of time.
    divergence: float


def surface_figures(morph: Morph, time: float, mesh: SimplexMesh) -> SurfaceFigures:
    """Look at the surface of a morph.

    Args:
        morph: the morph.
        time: when.
        mesh: its surface then, as `nsm.geometry.meshing.extract_surface` gives it.
    """
    parts = topology.component_measures(mesh)
    area = float(parts.sum())
    counts = (len(parts), Pieces.of(mesh).components, topology.euler_number(mesh), topology.genus(mesh))
    if not area > 0:
        return SurfaceFigures(time, *counts, 0.0, area, *[math.nan] * 6)
    generator = torch.Generator(mesh.vertices.device).manual_seed(0)
    points = sample_mesh(mesh, SAMPLES, generator).points
    norm = morph.gradient(points, time).detach().norm(dim=1)
    residual = level_set_residual(morph, points, time)
    return SurfaceFigures(
        time,
        *counts,
        float(parts[0]) / area,
        area,
        topology.mean_dihedral_angle(mesh),
        float(norm.mean()),
        float(norm.std()),
        float((rate(morph, points, time).abs() / norm).mean()),
        mean_size(None if residual is None else residual / norm),
        mean_size(divergence(morph, points, time)),
    )
