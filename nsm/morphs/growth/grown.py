"""A morph seen at a scale that changes with time."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm.morphs.growth.base import Growth
from nsm.shapes import FieldShape, Similarity
from nsm.types import Key, Morph, Networks, SignedDistance, Times


class Grown(Morph):
    """Morph with a changing volume, f̃(x, t) = α(t) f(x/α(t), t) (paper, equation 16).

    f̃ is a distance where f is, ∇f̃(x, t) = ∇f(x/α, t), and its surface is advected by

        Ṽ(x, t) = α V(x/α, t) + (α'/α) x,    div Ṽ(x, t) = div V(x/α, t) + d α'/α,

    the velocity of the scaled shape plus a growth about the origin. Off the surface a distance cannot both grow and be
    advected: where V advects f, ∂f̃/∂t + ⟨∇f̃, Ṽ⟩ = (α'/α) f̃, which vanishes on the surface only.

    f is evaluated inside its own box only, as networks take arbitrary values beyond it. Outside the scaled box, f̃ is
    its value at the nearest point of that box plus the distance to that point; V and div V are those at that point.

    Args:
        morph: f, at constant volume.
        growth: α.

    Attributes:
        bounds: Corners of a box that contains the box of ``morph`` at each of its scales, shape (2, d).
        source: Shape of ``morph`` at t = 0, scaled by α(0).
        target: Shape of ``morph`` at t = 1, scaled by α(1).

    Example:
        >>> import torch
        >>> from nsm.morphs.growth import Grown, VolumeLinear
        >>> from nsm.morphs.neural import NeuralMorph
        >>> from nsm.fields import ScalarSiren
        >>> from nsm.shapes import Ball
        >>> still = NeuralMorph(ScalarSiren(4, 8, 1), None, Ball(0.4), Ball(0.4)).requires_grad_(False)
        >>> Grown(still, VolumeLinear(3, source=1.0, target=8.0)).domain(1.0).tolist()
        [[-2.0, -2.0, -2.0], [2.0, 2.0, 2.0]]
    """

    def __init__(self, morph: Morph, growth: Growth) -> None:
        self.morph, self.growth, self.dim, self.provenance = morph, growth, morph.dim, morph.provenance
        boxes = torch.stack([morph.bounds * relative ** (1 / morph.dim) for relative in growth.extremes])
        self.bounds = torch.stack([boxes[:, 0].amin(0), boxes[:, 1].amax(0)])
        self._keys = tuple(Key(key.time, _scaled(key.shape, growth.scale(key.time), self.dim)) for key in morph.keys)
        self.source, self.target = self._keys[0].shape, self._keys[-1].shape

    def __call__(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"]:
        """Signed distance (n,) at x (n, d) and time t, one number or (n,); negative inside."""
        near, beyond, scale = self._pulled_back(x, t)
        return scale[:, 0] * (self.morph(near, t) + beyond.norm(dim=1))

    def gradient(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"]:
        """Spatial gradient (n, d) of the signed distance."""
        near, beyond, _ = self._pulled_back(x, t)
        gradient = self.morph.gradient(near, t)
        return torch.where(beyond == 0, gradient, torch.nn.functional.normalize(beyond, dim=1))

    @property
    def keys(self) -> tuple[Key[SignedDistance], ...]:
        """Shapes of ``morph``, each at its scale α."""
        return self._keys

    @property
    def has_velocity(self) -> bool:
        return self.morph.has_velocity

    def velocity(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"] | None:
        """Velocity (n, d), in units of length per unit of t; None for a method without a velocity field."""
        near, _, scale = self._pulled_back(x, t)
        velocity = self.morph.velocity(near, t)
        return None if velocity is None else scale * velocity + self._rate(x, t) / scale * x

    def divergence(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"] | None:
        """Divergence (n,) of the velocity in space; None for a method without a velocity field."""
        near, _, scale = self._pulled_back(x, t)
        divergence = self.morph.divergence(near, t)
        return None if divergence is None else divergence + self.dim * (self._rate(x, t) / scale)[:, 0]

    def domain(self, t: float) -> Float[Tensor, "2 d"]:
        """Corners of the domain of the morph, scaled by α(t)."""
        return self.morph.domain(t) * self.growth.scale(t)

    def wanted_volume(self, t: float, initial: float = 1.0) -> float:
        """V(0) (α(t)/α(0))^d, with V(0) the initial volume."""
        relative = self.growth.relative_volume(t) / self.growth.relative_volume(0.0)
        return self.morph.wanted_volume(t, initial) * relative

    def networks(self) -> Networks:
        """f and V of ``morph``, with the growth as a part of the program, not of the weights."""
        program, description, _ = self.morph.networks()
        described = description | {"bounds": self.bounds.tolist(), "grown": True}
        return Networks(GrownProgram(program, self.growth), described, None)

    def _pulled_back(self, x: Tensor, t: Times) -> tuple[Tensor, Tensor, Tensor]:
        """Return x/α moved into the box of the morph (n, d), the offset from it (n, d), and α, shape (1 or n, 1)."""
        x = x.to(self.morph.bounds)
        scale = self.growth.scale(torch.as_tensor(t).to(x)).reshape(-1, 1)
        point = x / scale
        near = torch.minimum(torch.maximum(point, self.morph.bounds[0]), self.morph.bounds[1])
        return near, point - near, scale

    def _rate(self, x: Tensor, t: Times) -> Tensor:
        """α', shape (1 or n, 1)."""
        return self.growth.rate(torch.as_tensor(t).to(x)).reshape(-1, 1)


class GrownProgram(nn.Module):
    """The program of a grown morph: α f(x/α, t), ∇f(x/α, t), and α V(x/α, t) + (α'/α) x.

    Args:
        program: Program of the morph at constant volume (`nsm.types.Networks`).
        growth: α.
    """

    def __init__(self, program: nn.Module, growth: Growth) -> None:
        super().__init__()
        self.program, self.growth = program, growth

    def forward(self, points: Float[Tensor, "n d"], time: Float[Tensor, " n"]) -> tuple[Tensor, ...]:
        """f (n,), ∇f (n, d), and V (n, d) if there is a velocity field."""
        scale, rate = self.growth.scale(time), self.growth.rate(time)
        value, gradient, *velocity = self.program(points / scale[:, None], time)
        grown = tuple(scale[:, None] * V + (rate / scale)[:, None] * points for V in velocity)
        return (scale * value, gradient, *grown)


def _scaled(shape: SignedDistance, scale: float, dim: int) -> SignedDistance:
    """Scale a signed distance, s g(x/s); a `FieldShape` remains one."""
    if isinstance(shape, FieldShape):
        return shape.transformed(Similarity.scaling(scale, dim))
    return lambda x: scale * shape(x / scale)
