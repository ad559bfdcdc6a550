"""Does the velocity carry the source to where the morph says it is, and keep its volume on the way?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, cast

import torch

from nsm.geometry.advection import VelocityField, advect
from nsm.geometry.distance import DistanceSummary, closest_points
from nsm.geometry.topology import enclosed_volume, subdivided
from nsm.types import Morph, SimplexMesh


class TransportCheck(NamedTuple):
    """The surface at the first time, carried by V to all times.

    Attributes:
        times: increasing.
        volumes: inside the carried surface, over that at the first time, and over the wanted growth: 1 where it is
            kept.
        errors: how far each of them may be off, as a mesh that is carried does not stay as fine as it was.
        distances: from the vertices of the carried mesh to the surface of f; None where there is none.
    """

    times: tuple[float, ...]
    volumes: tuple[float, ...]
    errors: tuple[float, ...]
    distances: tuple[DistanceSummary | None, ...]

    @property
    def drift(self) -> float:
        """Greatest change of the carried volume, relative to that at the start."""
        return max(abs(volume - 1) for volume in self.volumes)

    @property
    def error(self) -> float:
        """Greatest of the errors: a drift below it is none that was seen."""
        return max(self.errors)

    @property
    def mean_distance(self) -> float:
        """Greatest over the times of the mean distance to f's surface; not a number where that is nowhere."""
        return max((d.mean for d in self.distances if d is not None), default=float("nan"))

    @property
    def maximum_distance(self) -> float:
        """Greatest distance of a vertex to f's surface at any time; not a number where that is nowhere."""
        return max((d.maximum for d in self.distances if d is not None), default=float("nan"))


def check_transport(
    morph: Morph, source: SimplexMesh, times: Sequence[float], meshes: Sequence[SimplexMesh]
) -> TransportCheck | None:
    """Carry the surface at the first time by V, without correction, and compare (theorem 1 of the paper).

    A flow that is free of divergence on the moving surface keeps the volume inside; and one that solves the level set
    equation stays on the surface. The surface is carried with the middles of its edges: its volume without them, V_2h,
    and with them, V_h, give by Richardson V = V_h + (V_h − V_2h) / 3 and the error |V_h − V_2h| / 3.

    Args:
        morph: the morph.
        source: its surface at the first time, to be carried.
        times: increasing.
        meshes: its surface at each of them, to compare with.

    Returns:
        The check; None for a morph without velocity, or without a surface at the first time.
    """
    if not len(source.simplices) or not morph.has_velocity:
        return None
    fine = subdivided(source)
    carried = advect(cast(VelocityField, morph.velocity), fine.vertices, times)
    # without the edges' middles
    corners = carried[:, : len(source.vertices)]
    with_middles, without, growth = torch.tensor(
        [
            [enclosed_volume(SimplexMesh(x.double(), fine.simplices)) for x in carried],
            [enclosed_volume(SimplexMesh(x.double(), source.simplices)) for x in corners],
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
    return TransportCheck(tuple(times), tuple(volumes.tolist()), tuple(errors.tolist()), tuple(distances))
