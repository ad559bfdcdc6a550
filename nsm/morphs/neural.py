"""A morph made of networks: what training yields, and what loads for inference."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm.fields import ScalarNetwork, Velocity
from nsm.shapes import FieldShape
from nsm.types import Jet, Morph

#: Points evaluated at once: large enough for full matrix products, small enough for any memory.
CHUNK = 1 << 16


class NeuralMorph(nn.Module, Morph):
    """A moving shape {f(·, t) < 0} with its velocity field and its two end shapes.

    Args:
        field: f(x, t), a scalar network of d + 1 inputs, time last.
        velocity: V(x, t), or None for a method without one.
        source: the shape at t = 0, posed and scaled.
        target: the shape at t = 1.
        half_width: the morph lies in the box [−h, h]^d, until `enclose` is given the box that it needs.

    Attributes:
        dim: dimension d of space.
        bounds: corners (2, d) of the box, lowest first; part of the state, so that a checkpoint carries it.
    """

    bounds: Tensor
    source: FieldShape
    target: FieldShape

    def __init__(
        self,
        field: ScalarNetwork,
        velocity: Velocity | None,
        source: FieldShape,
        target: FieldShape,
        half_width: float = 1.0,
    ) -> None:
        super().__init__()
        self.dim = field.in_features - 1
        self.field, self.velocity_field = field, velocity
        self.source, self.target = source, target
        self.provenance = {"source": source.provenance(), "target": target.provenance()}
        if velocity is not None:
            velocity.attach(field, target)
        corner = torch.full((self.dim,), float(half_width))
        self.register_buffer("bounds", torch.stack([-corner, corner]))

    def enclose(self, box: Float[Tensor, "2 d"]) -> None:
        """Take a box (corners (2, d), lowest first) that contains the moving shape at all times."""
        self.bounds.copy_(box)

    def forward(self, x: Float[Tensor, "n d"], t: float | Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """Signed distance (n,) at x (n, d) and time t, one number or (n,); negative inside."""
        return self._in_chunks(lambda p: self.field(p), self._spacetime(x, t))

    def jet(self, x: Float[Tensor, "n d"], t: float | Float[Tensor, " n"]) -> Jet:
        """Signed distance (n,) with its gradient (n, d + 1) in space and, last, in time."""
        p = self._spacetime(x, t)
        jets = [self.field.jet(chunk) for chunk in p.split(CHUNK)]
        return Jet(torch.cat([jet.value for jet in jets]), torch.cat([jet.gradient for jet in jets]))

    def gradient(self, x: Float[Tensor, "n d"], t: float | Float[Tensor, " n"]) -> Float[Tensor, "n d"]:
        """Spatial gradient (n, d) of the signed distance."""
        return self.jet(x, t).gradient[:, : self.dim]

    @property
    def has_velocity(self) -> bool:
        return self.velocity_field is not None

    def velocity(self, x: Float[Tensor, "n d"], t: float | Float[Tensor, " n"]) -> Float[Tensor, "n d"] | None:
        """Velocity (n, d), in units of length per unit of t; None for a method without a velocity field."""
        velocity = self.velocity_field
        if velocity is None:
            return None
        return self._in_chunks(lambda p: velocity(p, self.field.jet(p)), self._spacetime(x, t))

    def divergence(self, x: Float[Tensor, "n d"], t: float | Float[Tensor, " n"]) -> Float[Tensor, " n"] | None:
        """Divergence (n,) of the velocity in space; None for a method without a velocity field."""
        velocity = self.velocity_field
        if velocity is None:
            return None
        return self._in_chunks(lambda p: velocity.divergence(p, self.field.jet(p)), self._spacetime(x, t))

    def _spacetime(self, x: Tensor, t: float | Tensor) -> Tensor:
        """Points (n, d + 1) in the type and on the device of the networks."""
        if x.ndim != 2 or x.shape[1] != self.dim:
            raise ValueError(f"x has shape {tuple(x.shape)}, but this morph takes points of shape (n, {self.dim})")
        x = x.to(self.bounds)
        time = torch.as_tensor(t, dtype=x.dtype, device=x.device)
        if time.shape not in ((), (len(x),)):
            raise ValueError(f"t has shape {tuple(time.shape)}, but must be one number or of shape ({len(x)},)")
        return torch.cat([x, time.expand(len(x))[:, None]], 1)

    @staticmethod
    def _in_chunks(function: Callable[[Tensor], Tensor], p: Tensor) -> Tensor:
        return torch.cat([function(chunk) for chunk in p.split(CHUNK)])
