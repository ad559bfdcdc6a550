"""A morph seen at the times of a film."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.morphs.timing.base import Timing
from nsm.types import Key, Morph, Networks, SignedDistance, Times


class Retimed(Morph):
    """A morph f whose time follows a timing t(s), f̃(x, s) = f(x, t(s)).

    Its surface passes the same shapes at other times, and is advected by

        Ṽ(x, s) = t'(s) V(x, t(s)),    div Ṽ(x, s) = t'(s) div V(x, t(s)),

    so that what V preserves, Ṽ preserves too, and f̃ satisfies the level-set equation where f does.

    Args:
        morph: f.
        timing: t.

    Example:
        >>> import torch
        >>> from nsm.fields import ScalarSiren
        >>> from nsm.morphs.neural import NeuralMorph
        >>> from nsm.morphs.timing import Retimed, Smooth
        >>> from nsm.shapes import Ball
        >>> morph = NeuralMorph(ScalarSiren(4, 8, 1), None, Ball(0.4), Ball(0.5)).requires_grad_(False)
        >>> x = torch.rand(5, 3)
        >>> bool((Retimed(morph, Smooth())(x, 0.25) == morph(x, 0.15625)).all())
        True
    """

    def __init__(self, morph: Morph, timing: Timing) -> None:
        self.morph, self.timing = morph, timing
        self.dim, self.bounds, self.provenance = morph.dim, morph.bounds, morph.provenance
        self.source, self.target = morph.source, morph.target

    def __call__(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"]:
        return self.morph(x, self.timing(t))

    def gradient(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"]:
        return self.morph.gradient(x, self.timing(t))

    @property
    def keys(self) -> tuple[Key[SignedDistance], ...]:
        """Shapes of the morph at the film times that show them."""
        return tuple(Key(self.timing.inverse(key.time), key.shape) for key in self.morph.keys)

    @property
    def has_velocity(self) -> bool:
        return self.morph.has_velocity

    def velocity(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"] | None:
        """Velocity t' V in units of length per unit of film time, shape (n, d); None for a morph without one."""
        velocity = self.morph.velocity(x, self.timing(t))
        return None if velocity is None else self._rate(t).to(velocity) * velocity

    def divergence(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"] | None:
        """Divergence of the velocity per unit of film time, shape (n,); None for a morph without a velocity."""
        divergence = self.morph.divergence(x, self.timing(t))
        return None if divergence is None else self._rate(t)[:, 0].to(divergence) * divergence

    def domain(self, t: float) -> Float[Tensor, "2 d"]:
        """Corners of the domain of the morph at the time that the film shows, shape (2, d)."""
        return self.morph.domain(self.timing(t))

    def wanted_volume(self, t: float, initial: float = 1.0) -> float:
        """Volume that the shape should have at film time t, in the units of ``initial``."""
        return self.morph.wanted_volume(self.timing(t), initial)

    def networks(self) -> Networks:
        """Refuse: programs take the time of the morph itself.

        Raises:
            InputError: Always.
        """
        raise InputError(
            f"`timing` must be linear for a format that holds the networks, got {type(self.timing).__name__}. Try "
            "`timing=linear`."
        )

    def _rate(self, t: Times) -> Float[Tensor, "k 1"]:
        """t' at one time or at each of n, shape (1 or n, 1)."""
        return self.timing.rate(torch.as_tensor(t, dtype=torch.double)).reshape(-1, 1)
