"""The part of a morph between two of its keys."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from nsm.types import Morph, Times


class Leg(Morph):
    """The part of a morph f between two successive keys, in a time s of its own that runs from 0 to 1.

    With the times a and b of the two keys and t = a + (b − a) s,

        f̃(x, s) = f(x, t),   ∇f̃ = ∇f,   Ṽ = (b − a) V(x, t),   div Ṽ = (b − a) div V.

    Args:
        morph: f.
        number: Number of the leg, from 0; the first begins at the source.

    Example:
        >>> import torch
        >>> from nsm.fields import ScalarSiren
        >>> from nsm.morphs.leg import Leg
        >>> from nsm.morphs.neural import NeuralMorph
        >>> from nsm.shapes import Ball
        >>> between = [Ball(0.5)]
        >>> morph = NeuralMorph(ScalarSiren(4, 8, 1), None, Ball(0.4), Ball(0.6), between=between, times=[0, 0.2, 1])
        >>> leg, x = Leg(morph.requires_grad_(False), 1), torch.rand(5, 3)
        >>> bool((leg(x, 0.5) == morph(x, 0.6)).all()), leg.source.radius
        (True, 0.5)
    """

    def __init__(self, morph: Morph, number: int) -> None:
        before, after = morph.keys[number : number + 2]
        self.morph, self.start, self.length = morph, before.time, after.time - before.time
        self.dim, self.bounds, self.provenance = morph.dim, morph.bounds, {}
        self.source, self.target = before.shape, after.shape

    def __call__(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"]:
        return self.morph(x, self.outer_time(t))

    def gradient(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"]:
        return self.morph.gradient(x, self.outer_time(t))

    @property
    def has_velocity(self) -> bool:
        return self.morph.has_velocity

    def velocity(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"] | None:
        """Velocity per unit of the time of the leg, shape (n, d); None for a morph without one."""
        velocity = self.morph.velocity(x, self.outer_time(t))
        return None if velocity is None else self.length * velocity

    def divergence(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"] | None:
        divergence = self.morph.divergence(x, self.outer_time(t))
        return None if divergence is None else self.length * divergence

    def domain(self, t: float) -> Float[Tensor, "2 d"]:
        return self.morph.domain(self.start + self.length * t)

    def wanted_volume(self, t: float, initial: float = 1.0) -> float:
        relative = self.morph.wanted_volume(self.start + self.length * t) / self.morph.wanted_volume(self.start)
        return initial * relative

    def outer_time(self, t: Times) -> Times:
        """Time of the morph at a time of the leg."""
        return self.start + self.length * t

    def own_time(self, t: Times) -> Times:
        """Time of the leg at a time of the morph."""
        return (t - self.start) / self.length


def legs(morph: Morph) -> tuple[Leg, ...]:
    """All legs of a morph, in order of time."""
    return tuple(Leg(morph, number) for number in range(len(morph.keys) - 1))
