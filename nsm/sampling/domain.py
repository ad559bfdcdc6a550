"""Where and when interior points are drawn."""

from __future__ import annotations

import torch
from torch import Tensor

from nsm.cli.errors import InputError


class Box:
    """The cube [−h, h]^d, sampled uniformly.

    Args:
        dim: d.
        half_width: h. The shapes lie in [−1, 1]^d; the equations are asked for a little beyond.
    """

    def __init__(self, dim: int, half_width: float = 1.5) -> None:
        if not half_width >= 1:
            raise InputError(f"sampler.box.half_width={half_width} leaves out part of [−1, 1]^{dim}: give 1 or more")
        self.dim, self.half_width = dim, float(half_width)

    def draw(self, n: int, generator: torch.Generator) -> Tensor:
        """Points (n, d)."""
        return (torch.rand(n, self.dim, generator=generator) * 2 - 1) * self.half_width


class UniformTime:
    """Times drawn uniformly from [start, stop].

    Args:
        start, stop: the interval. The authors' code draws from [−0.2, 1]; the paper's is [0, 1].
    """

    def __init__(self, start: float = 0.0, stop: float = 1.0) -> None:
        if not start < stop:
            raise InputError(f"sampler.time has start={start} and stop={stop}: give a start before the stop")
        self.start, self.stop = float(start), float(stop)

    def draw(self, n: int, generator: torch.Generator) -> Tensor:
        """Times (n,)."""
        return torch.rand(n, generator=generator) * (self.stop - self.start) + self.start
