"""Batches: points on the surfaces, around them, and inside space-time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.sampling.domain import Box, UniformTime
from nsm.sampling.pools import Pools


class Batch(NamedTuple):
    """Points in the order surface, ambient, interior, with the targets known at the first two.

    Attributes:
        points: (n, k), in space-time (x, t) for a morph and in space for a still shape.
        distances: signed distance (s + a,) at surface and ambient points, zero on the surface.
        normals: unit normals (s, d) at the surface points.
    """

    points: Tensor
    distances: Tensor
    normals: Tensor

    @property
    def surface(self) -> slice:
        """The points on a surface."""
        return slice(0, len(self.normals))

    @property
    def ambient(self) -> slice:
        """The points around a shape, where its distance is known."""
        return slice(len(self.normals), len(self.distances))

    @property
    def interior(self) -> slice:
        """The points of space-time where nothing is known but the equations."""
        return slice(len(self.distances), len(self.points))


@dataclass(frozen=True)
class Fractions:
    """How a batch is divided (the authors' code: a quarter, a quarter, and half inside space-time)."""

    surface: float = 0.25
    ambient: float = 0.25

    def __post_init__(self) -> None:
        if not (self.surface >= 0 and self.ambient >= 0 and self.surface + self.ambient <= 1):
            raise InputError(
                f"sampler.fractions has surface={self.surface} and ambient={self.ambient}: give two parts of 1, such "
                "as 0.25 and 0.25"
            )

    def counts(self, size: int) -> tuple[int, int, int]:
        """Numbers of surface, ambient and interior points in a batch of ``size``."""
        surface = round(self.surface * size)
        ambient = min(round(self.ambient * size), size - surface)
        return surface, ambient, size - surface - ambient


class MorphSampler:
    """Draws batches for a morph: half of the known points from the source at t = 0, half from the target at t = 1.

    Args:
        source, target: pools of known points.
        box: where interior points are drawn.
        time: when.
        size: points in a batch.
        fractions: how they are divided.
    """

    def __init__(
        self, source: Pools, target: Pools, box: Box, time: UniformTime, size: int, fractions: Fractions
    ) -> None:
        self.ends, self.box, self.time = (source, target), box, time
        self.counts = fractions.counts(size)

    def draw(self, generator: torch.Generator) -> Batch:
        """One batch."""
        surface, ambient, interior = self.counts
        on = [pools.surface(n, generator) for pools, n in zip(self.ends, _halves(surface), strict=True)]
        around = [pools.ambient(n, generator) for pools, n in zip(self.ends, _halves(ambient), strict=True)]
        space = torch.cat([*(s.points for s in on), *(s.points for s in around), self.box.draw(interior, generator)])
        ends = torch.cat(
            [torch.full((n,), float(t)) for count in (surface, ambient) for t, n in enumerate(_halves(count))]
        )
        when = torch.cat([ends, self.time.draw(interior, generator)]).to(space)
        distances = torch.cat([space.new_zeros(surface), *(s.distances for s in around)])
        return Batch(torch.cat([space, when[:, None]], 1), distances, torch.cat([s.normals for s in on]))


class SdfSampler:
    """Draws batches for one still shape: points on it and around it, none of space-time.

    Args:
        pools: the known points.
        box: where the points without a known distance are drawn (Eikonal only).
        size: points in a batch.
        fractions: how they are divided.
    """

    def __init__(self, pools: Pools, box: Box, size: int, fractions: Fractions) -> None:
        self.pools, self.box = pools, box
        self.counts = fractions.counts(size)

    def draw(self, generator: torch.Generator) -> Batch:
        """One batch."""
        surface, ambient, interior = self.counts
        on, around = self.pools.surface(surface, generator), self.pools.ambient(ambient, generator)
        points = torch.cat([on.points, around.points, self.box.draw(interior, generator)])
        return Batch(points, torch.cat([points.new_zeros(surface), around.distances]), on.normals)


def _halves(n: int) -> tuple[int, int]:
    return n - n // 2, n // 2
