"""Pools of points whose targets were computed once, before training."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from nsm.types import DistanceSamples, SurfaceSamples


@dataclass(frozen=True)
class Pools:
    """Known points of one shape, from which batches are drawn with replacement."""

    on_surface: SurfaceSamples
    in_space: DistanceSamples

    def surface(self, n: int, generator: torch.Generator) -> SurfaceSamples:
        """n points on the surface with their normals."""
        pick = torch.randint(len(self.on_surface.points), (n,), generator=generator)
        return SurfaceSamples(*(part[pick] for part in self.on_surface))

    def ambient(self, n: int, generator: torch.Generator) -> DistanceSamples:
        """n points in space with their signed distances."""
        pick = torch.randint(len(self.in_space.points), (n,), generator=generator)
        return DistanceSamples(*(part[pick] for part in self.in_space))
