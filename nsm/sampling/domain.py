"""Distributions of interior points in space and time."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError


class Box:
    """The uniform distribution on the cube [−h, h]^d.

    Args:
        dim: Dimension d of space.
        half_width: Half the edge h of the cube, at least 1: the shapes lie in [−1, 1]^d, and the equations apply
            somewhat beyond.

    Raises:
        InputError: If the cube does not contain [−1, 1]^d.

    Example:
        >>> import torch
        >>> from nsm.sampling import Box
        >>> Box(dim=3, half_width=1.5).draw(100, torch.Generator().manual_seed(0)).shape
        torch.Size([100, 3])
    """

    def __init__(self, dim: int, half_width: float = 1.5) -> None:
        if not half_width >= 1:
            raise InputError(
                f"`sampler.box.half_width` must be at least 1 to contain the shapes, got {half_width}. Try "
                "`sampler.box.half_width=1.5`."
            )
        self.dim, self.half_width = dim, float(half_width)

    def draw(self, n: int, generator: torch.Generator) -> Float[Tensor, "n d"]:
        """Draw points, shape (n, d)."""
        return (torch.rand(n, self.dim, generator=generator) * 2 - 1) * self.half_width


class UniformTime:
    """The uniform distribution of times on [start, stop].

    Args:
        start, stop: The interval. The paper uses [0, 1], the code of its authors [−0.2, 1].

    Raises:
        InputError: If ``start`` is not less than ``stop``.
    """

    def __init__(self, start: float = 0.0, stop: float = 1.0) -> None:
        if not start < stop:
            raise InputError(
                f"`sampler.time.start` must be less than `sampler.time.stop`, got {start} and {stop}. Try "
                "`sampler.time.start=0` and `sampler.time.stop=1`."
            )
        self.start, self.stop = float(start), float(stop)

    def draw(self, n: int, generator: torch.Generator) -> Float[Tensor, " n"]:
        """Draw times, shape (n,)."""
        return torch.rand(n, generator=generator) * (self.stop - self.start) + self.start
