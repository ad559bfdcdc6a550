"""Batches of points on the end surfaces, around them, and inside space-time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.sampling.domain import Box, UniformTime
from nsm.sampling.pools import Pools


class Batch(NamedTuple):
    """Points in the order surface, ambient, interior, with targets for the first two groups.

    Attributes:
        points: Points (x, t) in space-time for a morph, or x in space for a still shape, shape (n, k).
        distances: Signed distances at surface and ambient points, shape (s + a,); zero on the surface.
        normals: Unit normals at surface points, shape (s, d).

    Example:
        >>> import torch
        >>> from nsm.sampling import Batch
        >>> batch = Batch(points=torch.rand(8, 4), distances=torch.zeros(4), normals=torch.rand(3, 3))
        >>> batch.surface, batch.ambient, batch.interior
        (slice(0, 3, None), slice(3, 4, None), slice(4, 8, None))
    """

    points: Float[Tensor, "n k"]
    distances: Float[Tensor, " m"]
    normals: Float[Tensor, "s d"]

    @property
    def surface(self) -> slice:
        """Index range of the points on an end surface."""
        return slice(0, len(self.normals))

    @property
    def ambient(self) -> slice:
        """Index range of the points around an end shape, where its signed distance is known."""
        return slice(len(self.normals), len(self.distances))

    @property
    def interior(self) -> slice:
        """Index range of the points without targets, where only the equations apply."""
        return slice(len(self.distances), len(self.points))


@dataclass(frozen=True)
class Fractions:
    """The composition of a batch; the remainder consists of interior points.

    Args:
        surface: Fraction of points on the end surfaces. The code of the paper's authors uses 1/4.
        ambient: Fraction of points around the end surfaces. The code of the paper's authors uses 1/4.

    Raises:
        InputError: If the fractions are negative or exceed 1 in total.

    Example:
        >>> from nsm.sampling import Fractions
        >>> Fractions(surface=0.25, ambient=0.25).counts(5000)
        (1250, 1250, 2500)
    """

    surface: float = 0.25
    ambient: float = 0.25

    def __post_init__(self) -> None:
        if not (self.surface >= 0 and self.ambient >= 0 and self.surface + self.ambient <= 1):
            raise InputError(
                "`sampler.fractions` must be non-negative with a sum of at most 1, got "
                f"surface={self.surface} and ambient={self.ambient}. Try `sampler.fractions.surface=0.25` and "
                "`sampler.fractions.ambient=0.25`."
            )

    def counts(self, size: int) -> tuple[int, int, int]:
        """Count the surface, ambient, and interior points in a batch of ``size`` points."""
        surface = round(self.surface * size)
        ambient = min(round(self.ambient * size), size - surface)
        return surface, ambient, size - surface - ambient


class MorphSampler:
    """A sampler of batches for a morph, with equal numbers of points from each shape that it passes through.

    Args:
        pools: Points with known targets of each shape, by its time, in order of time.
        box: Distribution of interior points in space.
        time: Distribution of interior points in time.
        size: Number of points in a batch.
        fractions: Composition of a batch.
    """

    def __init__(
        self, pools: Mapping[float, Pools], box: Box, time: UniformTime, size: int, fractions: Fractions
    ) -> None:
        self.pools, self.box, self.time = dict(pools), box, time
        self.counts = fractions.counts(size)

    def draw(self, generator: torch.Generator) -> Batch:
        """Draw a batch."""
        surface, ambient, interior = self.counts
        pools, shares = self.pools.values(), [_shares(count, len(self.pools)) for count in (surface, ambient)]
        on = [pool.surface(n, generator) for pool, n in zip(pools, shares[0], strict=True)]
        around = [pool.ambient(n, generator) for pool, n in zip(pools, shares[1], strict=True)]
        space = torch.cat([*(s.points for s in on), *(s.points for s in around), self.box.draw(interior, generator)])
        known = [torch.full((n,), time) for share in shares for time, n in zip(self.pools, share, strict=True)]
        when = torch.cat([*known, self.time.draw(interior, generator)]).to(space)
        distances = torch.cat([space.new_zeros(surface), *(s.distances for s in around)])
        return Batch(torch.cat([space, when[:, None]], 1), distances, torch.cat([s.normals for s in on]))


class SdfSampler:
    """A sampler of batches for a single still shape, without time.

    Args:
        pools: Pools of points with known targets.
        box: Distribution of interior points, which serve the Eikonal term.
        size: Number of points in a batch.
        fractions: Composition of a batch.
    """

    def __init__(self, pools: Pools, box: Box, size: int, fractions: Fractions) -> None:
        self.pools, self.box = pools, box
        self.counts = fractions.counts(size)

    def draw(self, generator: torch.Generator) -> Batch:
        """Draw a batch."""
        surface, ambient, interior = self.counts
        on, around = self.pools.surface(surface, generator), self.pools.ambient(ambient, generator)
        points = torch.cat([on.points, around.points, self.box.draw(interior, generator)])
        return Batch(points, torch.cat([points.new_zeros(surface), around.distances]), on.normals)


def _shares(n: int, parts: int) -> list[int]:
    """Split n points as evenly as possible, the larger shares first."""
    return [n // parts + (part < n % parts) for part in range(parts)]
