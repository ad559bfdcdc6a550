"""Morphs that equal every shape they pass through exactly."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nsm.geometry.flow import FlowError
from nsm.morphs.exact_ends import ExactEnds
from nsm.morphs.leg import legs
from nsm.types import Key, Morph, SignedDistance, Times


class ExactKeys(Morph):
    """Morph that is exactly its shape at the time of each key, even where its networks missed detail.

    Between two keys it is the morph with exact ends (`ExactEnds`) of that leg (`nsm.morphs.leg.Leg`), so that the
    detail that f lacks at a key is advected by V on both sides of it, up to the keys before and after. V and its
    divergence are those of the morph.

    Args:
        morph: f, with a velocity and any number of keys.

    Raises:
        InputError: If the morph has no velocity.

    Example:
        >>> from functools import partial
        >>> import torch
        >>> from nsm import ExactKeys
        >>> from nsm.fields import Free, ScalarSiren, VectorSiren
        >>> from nsm.morphs.neural import NeuralMorph
        >>> from nsm.shapes import Ball
        >>> velocity = Free(2, partial(VectorSiren, hidden_features=8, hidden_layers=1, omega=10.0))
        >>> balls = [Ball(radius, [0.0, 0.0]) for radius in (0.3, 0.4, 0.5)]
        >>> network = NeuralMorph(ScalarSiren(3, 8, 1), velocity, balls[0], balls[2], between=[balls[1]])
        >>> morph, x = ExactKeys(network.requires_grad_(False)), torch.rand(5, 2)
        >>> all((morph(x, key.time) == key.shape(x)).all() for key in morph.keys)
        True
    """

    def __init__(self, morph: Morph) -> None:
        self.morph, self.dim, self.bounds = morph, morph.dim, morph.bounds
        self.source, self.target, self.provenance = morph.source, morph.target, morph.provenance
        self._legs = legs(morph)
        self._exact = [ExactEnds(leg) for leg in self._legs]

    @property
    def keys(self) -> tuple[Key[SignedDistance], ...]:
        """Shapes of the morph."""
        return self.morph.keys

    def __call__(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"]:
        """Signed distance (n,) at x (n, d) and t, one time or n of them; negative inside."""
        if isinstance(t, Tensor) and t.ndim:
            value = x.new_empty(len(x)).to(self.bounds)
            for number, here in self._by_leg(t):
                value[here] = self._exact[number](x[here], self._legs[number].own_time(t[here]))
            return value
        number = self._leg_at(float(t))
        return self._exact[number](x, self._legs[number].own_time(float(t)))

    def gradient(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"]:
        """Spatial gradient (n, d) of the signed distance."""
        if isinstance(t, Tensor) and t.ndim:
            gradient = torch.empty_like(x).to(self.bounds)
            for number, here in self._by_leg(t):
                gradient[here] = self._exact[number].gradient(x[here], self._legs[number].own_time(t[here]))
            return gradient
        number = self._leg_at(float(t))
        return self._exact[number].gradient(x, self._legs[number].own_time(float(t)))

    @property
    def has_velocity(self) -> bool:
        return True

    def velocity(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"] | None:
        """Velocity (n, d) of the morph in units of length per unit of t."""
        return self.morph.velocity(x, t)

    def divergence(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"] | None:
        """Divergence (n,) of the velocity of the morph in space."""
        return self.morph.divergence(x, t)

    def domain(self, t: float) -> Float[Tensor, "2 d"]:
        """Corners (2, d) of the box in which the morph is known at time t."""
        return self.morph.domain(t)

    def wanted_volume(self, t: float, initial: float = 1.0) -> float:
        """Volume that the morph should have at time t."""
        return self.morph.wanted_volume(t, initial)

    def flow_error(self) -> FlowError:
        """Compare the flow maps of all legs with direct integration (`ExactEnds.flow_error`)."""
        errors = [exact.flow_error() for exact in self._exact]
        mean, field = (sum(part) / len(errors) for part in ([e.mean for e in errors], [e.field for e in errors]))
        return FlowError(mean, max(error.maximum for error in errors), field)

    @cached_property
    def _starts(self) -> Float[Tensor, " k"]:
        """Times at which all legs but the first begin."""
        return torch.tensor([leg.start for leg in self._legs[1:]], dtype=torch.double)

    def _leg_at(self, t: float) -> int:
        return int((self._starts <= t).sum())

    def _by_leg(self, t: Float[Tensor, " n"]) -> Iterator[tuple[int, Bool[Tensor, " n"]]]:
        """Numbers of the legs that hold some of the times, and a mask of those times."""
        numbers = torch.bucketize(t.detach().double(), self._starts.to(t.device), right=True)
        for number in numbers.unique().tolist():
            yield number, numbers == number
