"""Advection of the source surface by V, compared with the surface of f and with the wanted volume."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple, cast

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.geometry.advection import VelocityField, advect
from nsm.geometry.distance import DistanceSummary, closest_points
from nsm.geometry.grid import Lattice, evaluate
from nsm.geometry.topology import enclosed_volume, measure
from nsm.types import Morph, SimplexMesh

#: Relative difference of two volumes that the errors of both may cause.
SLACK = 0.02


class AdvectionCheck(NamedTuple):
    """The surface at the first time, advected by V to all times.

    Attributes:
        times: Increasing times, k of them.
        volumes: Volume inside the advected surface over the wanted volume at each time: 1 where it is kept.
        errors: Estimated error of each of these volumes.
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
    morph: Morph, source: SimplexMesh, times: Sequence[float], meshes: Sequence[SimplexMesh], resolution: int
) -> AdvectionCheck | None:
    """Advect the shape at the first time by V, without projection, and compare it with the morph.

    A flow φ whose divergence vanishes on the moving surface keeps the volume inside (theorem 1 of the paper), and one
    that solves the level set equation stays on the surface of f, which the vertices of the source show. The volume
    inside the advected surface is ∫ det Dφ over the inside at the first time, with

        det Dφ(x, t) = exp ∫ div V(φ(x, s), s) ds.

    It needs no mesh that follows the surface where V stretches it. The integral is a sum over the middles of the cells
    of a grid, V_h, and of one that is twice as coarse, V_2h, in which cells at the surface count in part. By Richardson
    extrapolation

        V = V_h + (V_h − V_2h) / 3,    error = |V_h − V_2h| / 3.

    A velocity that is not smooth inside, such as that of NISE where ∇f vanishes, may tear open single points, whose
    images the sum misses. It then differs from the volume of f by more than the distance between both surfaces allows
    (`SLACK`). In that case the volume is that inside the advected mesh, and the difference its error.

    Args:
        morph: Morph to check.
        source: Surface of the morph at the first time, which is advected.
        times: Increasing times, k of them.
        meshes: Surface of the morph at each time, for comparison.
        resolution: Cells along the longest edge of ``morph.bounds`` of the finer grid.

    Returns:
        The comparison; None for a morph without velocity, or without a surface at the first time.

    References:
        J. Liouville, Note sur la théorie de la variation des constantes arbitraires, Journal de mathématiques pures et
        appliquées 3, 1838, for the determinant.
    """
    if not len(source.simplices) or not morph.has_velocity:
        return None
    moved = advect(cast(VelocityField, morph.velocity), source.vertices, times)
    distances = [
        DistanceSummary.of(closest_points(points, mesh).distances) if len(mesh.simplices) else None
        for points, mesh in zip(moved, meshes, strict=True)
    ]
    volumes, errors = _advected_volumes(morph, times, resolution)
    if not _agree(volumes, source, meshes, distances):
        of_mesh = _relative_volumes([SimplexMesh(x, source.simplices) for x in moved], source).to(volumes)
        volumes, errors = of_mesh, (of_mesh - volumes).abs()
    growth = torch.tensor([morph.wanted_volume(time) / morph.wanted_volume(times[0]) for time in times]).to(volumes)
    return AdvectionCheck(
        tuple(times), tuple((volumes / growth).tolist()), tuple((errors / growth).tolist()), tuple(distances)
    )


def _agree(
    volumes: Tensor, source: SimplexMesh, meshes: Sequence[SimplexMesh], distances: Sequence[DistanceSummary | None]
) -> bool:
    """Whether volumes differ from those of f by no more than the distances of the surfaces allow."""
    start = enclosed_volume(source)
    of_f = _relative_volumes(meshes, source)
    return all(
        distance is None or abs(volume - wanted) <= 2 * measure(mesh) * distance.mean / start + SLACK
        for volume, wanted, mesh, distance in zip(volumes.tolist(), of_f.tolist(), meshes, distances, strict=True)
    )


def _relative_volumes(meshes: Sequence[SimplexMesh], source: SimplexMesh) -> Float[Tensor, " k"]:
    """Volumes inside meshes over that inside the source."""
    volumes = [enclosed_volume(SimplexMesh(mesh.vertices.double(), mesh.simplices)) for mesh in (source, *meshes)]
    return torch.tensor(volumes[1:], dtype=torch.double) / volumes[0]


@torch.no_grad()
def _advected_volumes(
    morph: Morph, times: Sequence[float], resolution: int
) -> tuple[Float[Tensor, " k"], Float[Tensor, " k"]]:
    """Volumes inside the advected surface over that at the first time, and their estimated errors."""
    rough, fine = (_mean_determinants(morph, times, cells) for cells in (max(resolution // 2, 1), resolution))
    return fine + (fine - rough) / 3, (fine - rough).abs() / 3


def _mean_determinants(morph: Morph, times: Sequence[float], resolution: int) -> Float[Tensor, " k"]:
    """Mean of det Dφ inside at each time, from points in the middle of cells."""
    lattice = Lattice.centers(morph.bounds, resolution)
    points = lattice.points(lattice.indices())
    share = _share(evaluate(partial(morph, t=times[0]), points), float(lattice.step.max()))
    start, share = points[share > 0], share[share > 0]
    state = torch.cat([start, torch.zeros_like(start[:, :1])], 1)
    determinants = advect(partial(_expansion, morph), state, times)[:, :, -1].double().exp()
    return (determinants * share).sum(1) / share.sum()


def _share(distance: Tensor, cell: float) -> Float[Tensor, " n"]:
    """Share of the cell around each point that is inside, for a surface that is flat within the cell."""
    return (0.5 - distance.double() / cell).clamp(0, 1)


def _expansion(morph: Morph, state: Tensor, t: float) -> Tensor:
    """Rates of change of the positions of points and, last, of log det Dφ there."""
    x = state[:, :-1]
    velocity, divergence = morph.velocity(x, t), morph.divergence(x, t)
    assert velocity is not None
    assert divergence is not None
    return torch.cat([velocity, divergence[:, None]], 1)
