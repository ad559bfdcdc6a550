"""Properties of the surface of a morph at one time: topology, area, roughness, ‖∇f‖, speed, and residuals."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.geometry import topology
from nsm.geometry.projection import project_to_level
from nsm.geometry.sampling import sample_mesh
from nsm.metrics.pieces import Pieces
from nsm.metrics.residuals import SAMPLES, divergence, level_set_residual, mean_magnitude, rate
from nsm.types import Jet, Morph, SimplexMesh


class SurfaceFigures(NamedTuple):
    """Properties of the surface at one time; nan where there is no surface, or no velocity.

    Attributes:
        time: The time.
        components: Number of connected components, however small.
        pieces: Number of connected components that are large enough to be seen (`nsm.metrics.pieces.LEAST_SHARE`).
        euler: Euler number of the surface. Counts are those of a closed surface, one that does not leave the box.
        genus: Number of handles, all components together; 0 in 2D.
        largest_share: Area of the largest component over the whole area; 0 where there is no surface.
        area: Area (length in 2D).
        roughness: Mean angle in degrees between neighboring triangles (segments); grows with the size of the cells.
        gradient_norm: Mean of ‖∇f‖: 1 for a distance.
        gradient_norm_std: Standard deviation of ‖∇f‖: 0 for a distance.
        speed: Mean of |∂f/∂t| / ‖∇f‖, the speed of the surface along its normal.
        level_set: Mean of |∂f/∂t + ⟨∇f, V⟩| / ‖∇f‖, the speed along the normal at which V and the surface part.
        divergence: Mean of |div V|, per unit of time.
    """

    time: float
    components: int
    pieces: int
    euler: int
    genus: int
    largest_share: float
    area: float
    roughness: float
    gradient_norm: float
    gradient_norm_std: float
    speed: float
    level_set: float
    divergence: float


def surface_figures(morph: Morph, time: float, mesh: SimplexMesh, samples: int = SAMPLES) -> SurfaceFigures:
    """Measure the surface of a morph at one time.

    Args:
        morph: Morph to measure.
        time: The time.
        mesh: Surface of the morph at that time, as `nsm.geometry.meshing.extract_surface` gives it.
        samples: Number of points drawn on it.
    """
    parts = topology.component_measures(mesh)
    area = float(parts.sum())
    counts = (len(parts), Pieces.of(mesh).components, topology.euler_number(mesh), topology.genus(mesh))
    if not area > 0:
        return SurfaceFigures(time, *counts, 0.0, area, *[math.nan] * 6)
    generator = torch.Generator(mesh.vertices.device).manual_seed(0)
    points = _onto_surface(morph, sample_mesh(mesh, samples, generator).points, time)
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
        mean_magnitude(None if residual is None else residual / norm),
        mean_magnitude(divergence(morph, points, time)),
    )


def _onto_surface(morph: Morph, points: Float[Tensor, "n d"], time: float) -> Float[Tensor, "n d"]:
    """Points of a mesh moved to the zero level of f; those where Newton's method fails stay.

    A mesh deviates from that level by about the square of its cells. Quantities that vanish there, such as the
    divergence of an adaptive-divergence velocity, would show the deviation of the mesh instead.
    """
    return project_to_level(lambda x: Jet(morph(x, time), morph.gradient(x, time)), points).points
