"""Pools of points whose targets are computed once, before training."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from nsm.types import DistanceSamples, SurfaceSamples


@dataclass(frozen=True)
class Pools:
    """Points of one shape with known targets, from which batches are drawn with replacement.

    Attributes:
        on_surface: Points on the surface with their normals.
        in_space: Points around the shape with their signed distances.
    """

    on_surface: SurfaceSamples
    in_space: DistanceSamples

    def surface(self, n: int, generator: torch.Generator) -> SurfaceSamples:
        """Draw n points on the surface with their normals."""
        pick = torch.randint(len(self.on_surface.points), (n,), generator=generator)
        return SurfaceSamples(*(part[pick] for part in self.on_surface))

    def ambient(self, n: int, generator: torch.Generator) -> DistanceSamples:
        """Draw n points around the shape with their signed distances."""
        pick = torch.randint(len(self.in_space.points), (n,), generator=generator)
        return DistanceSamples(*(part[pick] for part in self.in_space))
