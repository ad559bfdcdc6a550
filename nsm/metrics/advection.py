"""Advection of the source surface by V, compared with the surface of f and with the wanted volume."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, cast

import torch

from nsm.geometry.advected_mesh import advect_mesh
from nsm.geometry.advection import VelocityField
from nsm.geometry.distance import DistanceSummary, closest_points
from nsm.geometry.topology import enclosed_volume
from nsm.types import Morph, SimplexMesh


class AdvectionCheck(NamedTuple):
    """The surface at the first time, advected by V to all times.

    Attributes:
        times: Increasing times, k of them.
        volumes: Volume inside the advected surface over the wanted volume at each time: 1 where it is kept.
        errors: Estimated error of each of these volumes, since a mesh becomes coarser where V stretches it.
        distances: Distances from the vertices of the advected mesh to the surface of f at each time; None where f has
            no surface.
    """

    times: tuple[float, ...]
    volumes: tuple[float, ...]
    errors: tuple[float, ...]
    distances: tuple[DistanceSummary | None, ...]

    @property
    def drift(self) -> float:
        """Greatest deviation of the advected volume from the wanted one, relative."""
        return max(abs(volume - 1) for volume in self.volumes)

    @property
    def error(self) -> float:
        """Greatest estimated error of the volumes; a drift below it is not significant."""
        return max(self.errors)

    @property
    def mean_distance(self) -> float:
        """Mean distance to the surface of f at the time when it is greatest; nan where f never has a surface."""
        return max((d.mean for d in self.distances if d is not None), default=float("nan"))

    @property
    def maximum_distance(self) -> float:
        """Greatest distance of a vertex to the surface of f at any time; nan where f never has a surface."""
        return max((d.maximum for d in self.distances if d is not None), default=float("nan"))


def check_advection(
    morph: Morph, source: SimplexMesh, times: Sequence[float], meshes: Sequence[SimplexMesh]
) -> AdvectionCheck | None:
    """Advect the surface at the first time by V, without projection, and compare it with the morph.

    A flow whose divergence vanishes on the moving surface keeps the volume inside (theorem 1 of the paper), and one
    that solves the level set equation stays on the surface of f. The surface is refined where the flow stretches it
    (`nsm.geometry.advected_mesh`), and advected with the midpoints of its edges. Its volume without them, V_2h, and
    with them, V_h, give by Richardson extrapolation

        V = V_h + (V_h − V_2h) / 3,    error = |V_h − V_2h| / 3.

    Args:
        morph: Morph to check.
        source: Surface of the morph at the first time, which is advected.
        times: Increasing times, k of them.
        meshes: Surface of the morph at each time, for comparison.

    Returns:
        The comparison; None for a morph without velocity, or without a surface at the first time.
    """
    if not len(source.simplices) or not morph.has_velocity:
        return None
    moved = advect_mesh(cast(VelocityField, morph.velocity), source, times)
    corners = moved.positions[:, : len(source.vertices)]
    with_middles, without, growth = torch.tensor(
        [
            [enclosed_volume(SimplexMesh(x.double(), moved.fine_simplices)) for x in moved.fine_positions],
            [enclosed_volume(SimplexMesh(x.double(), moved.simplices)) for x in moved.positions],
            [morph.wanted_volume(time) / morph.wanted_volume(times[0]) for time in times],
        ],
        dtype=torch.double,
    )
    wanted = with_middles[0] * growth
    volumes = (with_middles + (with_middles - without) / 3) / wanted
    errors = (with_middles - without).abs() / 3 / wanted
    distances = [
        DistanceSummary.of(closest_points(points, mesh).distances) if len(mesh.simplices) else None
        for points, mesh in zip(corners, meshes, strict=True)
    ]
    return AdvectionCheck(tuple(times), tuple(volumes.tolist()), tuple(errors.tolist()), tuple(distances))
