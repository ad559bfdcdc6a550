"""Morph made of networks, as training makes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm.cli.settings import increasing, invalid
from nsm.fields import ScalarNetwork, Velocity
from nsm.morphs.networks import portable_networks
from nsm.shapes import FieldShape
from nsm.types import Jet, Key, Morph, Networks, Times

#: Number of points evaluated at once: large enough for full matrix products, small enough for any memory.
CHUNK = 1 << 16


class NeuralMorph(nn.Module, Morph):
    """Moving shape {f(·, t) < 0} with its velocity field and its two end shapes.

    Args:
        field: Scalar network f(x, t) of d + 1 inputs, time last.
        velocity: Velocity V(x, t), or None for a method without one.
        source: Shape at t = 0, posed and scaled.
        target: Shape at t = 1.
        half_width: h of the box [−h, h]^d, which contains the morph until `enclose` sets another box.
        between: Shapes that the morph passes through on its way, posed and scaled.
        times: Times of all shapes from 0 for the source to 1 for the target; None for evenly spaced ones.

    Raises:
        InputError: If the times do not increase from 0 to 1, or there is not one for each shape.

    Attributes:
        bounds: Corners of the box, shape (2, d); part of the state, so that a checkpoint contains it.

    Example:
        >>> import torch
        >>> from nsm.fields import ScalarSiren
        >>> from nsm.morphs.neural import NeuralMorph
        >>> from nsm.shapes import Ball
        >>> morph = NeuralMorph(ScalarSiren(4, 8, 1), None, Ball(0.4), Ball(0.5)).requires_grad_(False)
        >>> x = torch.rand(10, 3)
        >>> morph(x, 0.5).shape, morph.gradient(x, torch.rand(10)).shape, morph.has_velocity
        (torch.Size([10]), torch.Size([10, 3]), False)
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
        between: Sequence[FieldShape] = (),
        times: Sequence[float] | None = None,
    ) -> None:
        super().__init__()
        self.dim = field.in_features - 1
        self.field, self.velocity_field = field, velocity
        self.source, self.target, self.between = source, target, nn.ModuleList(between)
        self.times = key_times(times, len(between) + 2)
        self.provenance = {"source": source.provenance(), "target": target.provenance()}
        if velocity is not None:
            velocity.attach(field, self.keys)
        corner = torch.full((self.dim,), float(half_width))
        self.register_buffer("bounds", torch.stack([-corner, corner]))

    @property
    def keys(self) -> tuple[Key[FieldShape], ...]:
        """Shapes that the morph passes through, in order of time."""
        shapes = [self.source, *self.between, self.target]
        return tuple(Key(time, shape) for time, shape in zip(self.times, shapes, strict=True))

    def enclose(self, box: Float[Tensor, "2 d"]) -> None:
        """Set ``bounds`` to a box that contains the moving shape at all times, corners of shape (2, d)."""
        self.bounds.copy_(box)

    def forward(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"]:
        """Signed distance (n,) at x (n, d) and t, one time or n of them; negative inside."""
        return self._in_chunks(lambda p: self.field(p), self._spacetime(x, t))

    def jet(self, x: Float[Tensor, "n d"], t: Times) -> Jet:
        """Signed distance (n,) with its gradient (n, d + 1) in space and, last, in time."""
        p = self._spacetime(x, t)
        jets = [self.field.jet(chunk) for chunk in p.split(CHUNK)]
        return Jet(torch.cat([jet.value for jet in jets]), torch.cat([jet.gradient for jet in jets]))

    def gradient(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"]:
        """Spatial gradient (n, d) of the signed distance."""
        return self.jet(x, t).gradient[:, : self.dim]

    @property
    def has_velocity(self) -> bool:
        return self.velocity_field is not None

    def velocity(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"] | None:
        """Velocity (n, d) in units of length per unit of t; None for a method without a velocity field."""
        velocity = self.velocity_field
        if velocity is None:
            return None
        return self._in_chunks(lambda p: velocity(p, self.field.jet(p)), self._spacetime(x, t))

    def divergence(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"] | None:
        """Divergence (n,) of the velocity in space; None for a method without a velocity field."""
        velocity = self.velocity_field
        if velocity is None:
            return None
        return self._in_chunks(lambda p: velocity.divergence(p, self.field.jet(p)), self._spacetime(x, t))

    def networks(self) -> Networks:
        """f and V as they are, without the end shapes."""
        copied = deepcopy(self).float().cpu().eval().requires_grad_(False)
        shapes = {"source": self.source.provenance(), "target": self.target.provenance()}
        return portable_networks(copied.field, copied.velocity_field, copied.bounds, shapes)

    def _spacetime(self, x: Tensor, t: Times) -> Tensor:
        """Points of space-time (n, d + 1) with the data type and the device of the networks."""
        if x.ndim != 2 or x.shape[1] != self.dim:
            raise ValueError(f"`x` must have shape (n, {self.dim}), got {tuple(x.shape)}.")
        x = x.to(self.bounds)
        time = torch.as_tensor(t, dtype=x.dtype, device=x.device)
        if time.shape not in ((), (len(x),)):
            raise ValueError(f"`t` must be one time or have shape ({len(x)},), got {tuple(time.shape)}.")
        return torch.cat([x, time.expand(len(x))[:, None]], 1)

    @staticmethod
    def _in_chunks(function: Callable[[Tensor], Tensor], p: Tensor) -> Tensor:
        return torch.cat([function(chunk) for chunk in p.split(CHUNK)])


def key_times(times: Sequence[float] | None, count: int) -> tuple[float, ...]:
    """Times of all keys of a morph.

    >>> key_times(None, 3)
    (0.0, 0.5, 1.0)

    Args:
        times: Increasing times from 0 to 1; None for evenly spaced ones.
        count: Number of keys.

    Raises:
        InputError: If the times do not increase from 0 to 1, or are not as many as the keys.
    """
    even = [round(number / (count - 1), 6) for number in range(count)]
    if times is None:
        return tuple(even)
    example = f"[{','.join(f'{time:g}' for time in even)}]"
    found = increasing("times", times, example)
    if len(found) != count or (found[0], found[-1]) != (0, 1):
        raise invalid("times", f"{count} times from 0 to 1, one for each shape", list(times), example)
    return tuple(found)
