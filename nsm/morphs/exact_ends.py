"""Morphs that start and end exactly at their shapes, and advect the detail that the networks missed."""

from __future__ import annotations

import math
from functools import cached_property, partial

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.advection import RungeKutta, advect
from nsm.geometry.flow import FlowError, FlowMaps
from nsm.geometry.grid import CHUNK, Lattice, evaluate
from nsm.geometry.meshing import extract_surface
from nsm.geometry.sampling import sample_mesh
from nsm.morphs.advected import velocity_of
from nsm.morphs.end_detail import EndDetail
from nsm.shapes.gradient import shape_gradient
from nsm.types import Morph, Times

#: Cells of the lattice on which V is sampled, along the longest edge of the box of the moving surface, by dimension,
#: and the number of times at which it is sampled.
FLOW_RESOLUTION = {2: 64, 3: 32}
FLOW_SLICES = 9
#: Cells along ``bounds``, and the number of times, at which that box is searched.
_SEARCH, _SEARCH_TIMES = 16, 9
#: Cells along the box of the lattice on which the differences at the ends are sampled, by dimension.
DETAIL_RESOLUTION = {2: 512, 3: 128}
#: Number of distinct times in one call above which V itself is integrated, instead of a flow map for each time.
_TIMES = 16
#: Step of the differences that give gradients, relative to the longest edge of the box.
_STEP = 5e-4
#: Cells of the surfaces on which the error of the flow maps is measured, number of points on each, and times.
_MEASURED, _POINTS, _MOMENTS = 32, 256, (0.25, 0.5, 0.75)
#: Integrator of V itself.
_DIRECT = RungeKutta(16)


class ExactEnds(Morph):
    """Morph whose ends are exactly its two shapes, even where its networks missed detail.

    With the missing detail h₀ = g₀ − f(·, 0) and h₁ = g₁ − f(·, 1), and the flow φ of V,

        f̃(x, t) = f(x, t) + cos²(πt/2) h₀(φ_{t→0}(x)) + sin²(πt/2) h₁(φ_{t→1}(x)),

    so that f̃ = g₀ at t = 0 and f̃ = g₁ at t = 1, and in between the detail that f lacks at an end is advected by V. At
    the ends g₀ and g₁ themselves are evaluated. Elsewhere φ comes from `nsm.geometry.flow.FlowMaps`, and hᵢ from a
    table of its values near the surfaces of gᵢ and f(·, i), faded to 0 away from both, so that f̃ has the sign of f
    there. Within `nsm.morphs.end_detail.NEAR` of an end, hᵢ itself gradually replaces the table, so that f̃ is
    continuous in time; detail finer than the cells of the table is visible that long.

    V and its divergence are those of the morph. The tables are computed when they are first needed.

    Args:
        morph: f, with a velocity and both end shapes.
        flow_resolution: Cells along the box of the moving surface on which V is sampled; by default
            `FLOW_RESOLUTION`.
        detail_resolution: Cells along the box on which h₀ and h₁ are sampled; by default `DETAIL_RESOLUTION`.

    Raises:
        InputError: If the morph has no velocity, or passes through more than two shapes.

    Example:
        >>> from functools import partial
        >>> import torch
        >>> from nsm import ExactEnds
        >>> from nsm.fields import Free, ScalarSiren, VectorSiren
        >>> from nsm.morphs.neural import NeuralMorph
        >>> from nsm.shapes import Ball
        >>> velocity = Free(2, partial(VectorSiren, hidden_features=8, hidden_layers=1, omega=10.0))
        >>> network = NeuralMorph(ScalarSiren(3, 8, 1), velocity, Ball(0.5, [0.0, 0.0]), Ball(0.4, [0.1, 0.0]))
        >>> morph = ExactEnds(network.requires_grad_(False))
        >>> x = torch.rand(5, 2)
        >>> bool((morph(x, 0.0) == network.source(x)).all() and (morph(x, 1.0) == network.target(x)).all())
        True
    """

    def __init__(self, morph: Morph, flow_resolution: int | None = None, detail_resolution: int | None = None) -> None:
        if len(morph.keys) != 2:
            raise InputError(
                f"`morph` must pass through two shapes to have exact ends, got {len(morph.keys)}. Try "
                "`nsm.ExactKeys(morph)`."
            )
        self._velocity = velocity_of(morph)
        self.morph, self.dim, self.bounds = morph, morph.dim, morph.bounds
        self.source, self.target, self.provenance = morph.source, morph.target, morph.provenance
        self.flow_resolution = flow_resolution or FLOW_RESOLUTION[morph.dim]
        self.detail_resolution = detail_resolution or DETAIL_RESOLUTION[morph.dim]

    def __call__(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"]:
        """Signed distance (n,) at x (n, d) and t, one time or n of them; negative inside."""
        x = x.to(self.bounds)
        if isinstance(t, Tensor) and t.ndim:
            return self._at_times(x, t)
        return torch.cat([self._value(chunk, float(t)) for chunk in x.split(CHUNK)])

    def gradient(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"]:
        """Spatial gradient (n, d) of the signed distance."""
        x = x.to(self.bounds)
        if isinstance(t, Tensor) and t.ndim:
            return self._gradient_at_times(x, t)
        return torch.cat([self._gradient(chunk, float(t)) for chunk in x.split(CHUNK)])

    @property
    def has_velocity(self) -> bool:
        return True

    def velocity(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"] | None:
        """Velocity (n, d) of the morph in units of length per unit of t."""
        return self.morph.velocity(x, t)

    def divergence(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"] | None:
        """Divergence (n,) of the velocity of the morph in space."""
        return self.morph.divergence(x, t)

    @torch.no_grad()
    def flow_error(self) -> FlowError:
        """Compare the flow maps and tables with direct integration at points of the surface at three times."""
        distances, differences = [], []
        for number, time in enumerate(_MOMENTS):
            mesh = extract_surface(partial(self, t=time), self.bounds, _MEASURED)
            if not len(mesh.simplices):
                continue
            x = sample_mesh(mesh, _POINTS, torch.Generator(self.bounds.device).manual_seed(number)).points
            moved = self.flow.at(time)(x).split(self.dim, 1)
            value = self.morph(x, time)
            for end, displacement in zip(self._ends, moved, strict=True):
                there = advect(self._velocity, x, [time, end.time], _DIRECT)[-1]
                distances.append((x + displacement - there).norm(dim=1))
                value = value + end.weight(torch.as_tensor(time).to(x)) * end.difference(there)
            differences.append((self(x, time) - value).abs())
        if not distances:
            return FlowError(math.nan, math.nan, math.nan)
        away = torch.cat(distances)
        return FlowError(float(away.mean()), float(away.max()), float(torch.cat(differences).mean()))

    @cached_property
    def flow(self) -> FlowMaps:
        """Flow of V from any time to both ends."""
        return FlowMaps(self._velocity, self._moving_box(), self.flow_resolution, FLOW_SLICES)

    def _moving_box(self) -> Tensor:
        """Part of the box, corners (2, d), where a term added to f may differ from 0 at some time."""
        lattice = Lattice.corners(self.bounds, _SEARCH)
        x = lattice.points(lattice.indices())
        margin = max(end.reach for end in self._ends) + float(lattice.step.norm())
        near = torch.zeros(len(x), dtype=torch.bool, device=x.device)
        for shape in (self.source, self.target):
            near |= evaluate(shape, x) < margin
        for time in torch.linspace(0, 1, _SEARCH_TIMES).tolist():
            near |= evaluate(partial(self.morph, t=time), x) < margin
        if not near.any():
            return self.bounds
        return torch.stack([x[near].amin(0), x[near].amax(0)])

    @cached_property
    def _ends(self) -> tuple[EndDetail, EndDetail]:
        return (
            EndDetail(self.morph, 0.0, self.source, self.detail_resolution),
            EndDetail(self.morph, 1.0, self.target, self.detail_resolution),
        )

    def _value(self, x: Tensor, t: float) -> Tensor:
        for end in self._ends:
            if t == end.time:
                return end.shape(x)
        time = min(max(t, 0.0), 1.0)
        places = self._split(self.flow.at(time)(x), x)
        return self.morph(x, t) + self._differences(places, torch.as_tensor(time).to(x))

    def _gradient(self, x: Tensor, t: float) -> Tensor:
        for end in self._ends:
            if t == end.time:
                return shape_gradient(end.shape, x, self._step)
        time = min(max(t, 0.0), 1.0)
        moved, jacobian = self.flow.at(time).jet(x)
        jacobians = [part + torch.eye(self.dim).to(x) for part in jacobian.split(self.dim, 1)]
        slopes = self._slopes(self._split(moved, x), jacobians, torch.as_tensor(time).to(x))
        return self.morph.gradient(x, t) + slopes

    def _at_times(self, x: Tensor, t: Tensor) -> Tensor:
        times, which = t.unique(return_inverse=True)
        if len(times) > _TIMES:
            return self.morph(x, t) + self._differences(self._integrated(x, t), t.to(x).clamp(0, 1))
        value = x.new_empty(len(x))
        for number, time in enumerate(times.tolist()):
            value[which == number] = self._value(x[which == number], time)
        return value

    def _gradient_at_times(self, x: Tensor, t: Tensor) -> Tensor:
        times, which = t.unique(return_inverse=True)
        if len(times) > _TIMES:
            # Jacobian of the flow by central differences
            steps = self._step * torch.eye(self.dim).to(x)
            after, before = ([self._integrated(x + sign * step, t) for step in steps] for sign in (1, -1))
            jacobians = [
                torch.stack([(b[end] - a[end]) / (2 * self._step) for b, a in zip(after, before, strict=True)], 2)
                for end in range(2)
            ]
            slopes = self._slopes(self._integrated(x, t), jacobians, t.to(x).clamp(0, 1))
            return self.morph.gradient(x, t) + slopes
        gradient = torch.empty_like(x)
        for number, time in enumerate(times.tolist()):
            gradient[which == number] = self._gradient(x[which == number], time)
        return gradient

    def _differences(self, places: tuple[Tensor, ...], t: Tensor) -> Tensor:
        """Sum of both terms that are added to f, (n,), given the positions of the points at the ends."""
        source, target = (end.value(place, t) for end, place in zip(self._ends, places, strict=True))
        return source + target

    def _slopes(self, places: tuple[Tensor, ...], jacobians: list[Tensor], t: Tensor) -> Tensor:
        """Gradient of both terms (n, d), given the positions at the ends and their Jacobians (n, d, d)."""
        source, target = (
            (end.gradient(place, t, self._step)[:, None] @ jacobian)[:, 0]
            for end, place, jacobian in zip(self._ends, places, jacobians, strict=True)
        )
        return source + target

    def _split(self, moved: Tensor, x: Tensor) -> tuple[Tensor, ...]:
        return tuple(x + part for part in moved.split(self.dim, 1))

    def _integrated(self, x: Tensor, t: Tensor) -> tuple[Tensor, ...]:
        """Positions at t = 0 and 1 of points, each with a time of its own, by the flow of V itself."""
        t = t.to(x).clamp(0, 1)[:, None]
        places = []
        for end in self._ends:
            stretch = torch.cat([x, t, end.time - t], 1)  # integrated over the share s in [0, 1] of each interval
            places.append(advect(self._stretched, stretch, [0.0, 1.0], _DIRECT)[-1, :, : self.dim])
        return tuple(places)

    def _stretched(self, state: Tensor, share: float) -> Tensor:
        """Rate of change of (x, start, length) when every interval [start, start + length] is scaled to [0, 1]."""
        x, start, length = state.split([self.dim, 1, 1], 1)
        velocity = self._velocity(x, (start + share * length)[:, 0])
        return torch.cat([length * velocity, torch.zeros_like(start), torch.zeros_like(length)], 1)

    @property
    def _step(self) -> float:
        return _STEP * float((self.bounds[1] - self.bounds[0]).max())
