"""The surface of a morph at one time: what is exported, drawn and viewed."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from nsm.cli.errors import InputError
from nsm.geometry.level import level_of_volume
from nsm.geometry.meshing import extract_surface, open_sides
from nsm.geometry.volume import volume
from nsm.types import Morph, SimplexMesh

log = logging.getLogger(__name__)

#: The level to extract at a time.
Levels = Callable[[float], float]
#: Cells along the box on which the volume at t = 0 is measured, by dimension.
VOLUME_RESOLUTION = {2: 512, 3: 128}
#: A level beyond this, in units of length, shows: the morph has lost or gained too much for an offset to hide.
LARGE_LEVEL = 0.01


class Frame(NamedTuple):
    """The surface {f(·, time) = level} with the normals ∇f/‖∇f‖ (v, d) at its vertices."""

    time: float
    level: float
    mesh: SimplexMesh
    normals: Float[Tensor, "v d"]


@torch.no_grad()
def extract_frame(morph: Morph, time: float, resolution: int, level: float = 0.0) -> Frame:
    """Extract the surface at one time; a warning tells where it leaves the box, beyond which it is not known.

    Args:
        morph: the morph.
        time: from 0 to 1.
        resolution: cells along the longest edge of ``morph.bounds``.
        level: the value of f on the surface.
    """
    mesh = extract_surface(partial(morph, t=time), morph.bounds, resolution, level)
    if sides := open_sides(mesh, morph.domain(time)):
        log.warning(
            "at t = %g the surface leaves the box by its sides %s and is cut there: train with smaller shapes "
            "(source.pose.scale=0.9 target.pose.scale=0.9), or in Python enlarge morph.bounds",
            time,
            ", ".join(sides),
        )
    return Frame(time, level, mesh, normalize(morph.gradient(mesh.vertices, time), dim=1))


def zero_level(time: float) -> float:
    """Level 0: the surface as f has it."""
    return 0.0


class ExactVolume:
    """Levels c(t) at which the mesh encloses the wanted volume: Vol{f(·, t) < c(t)} = V(t).

    V(t) is `nsm.types.Morph.wanted_volume` for the volume at t = 0 (`initial_volume`). What is made equal to it is the
    volume of the mesh (`nsm.geometry.level`).

    Args:
        morph: the morph.
        resolution: cells along the longest edge of ``morph.bounds``, those with which the surface is extracted.

    Attributes:
        levels: the level of each time that was asked for so far.
    """

    def __init__(self, morph: Morph, resolution: int) -> None:
        self.morph, self.resolution = morph, resolution
        self.levels: dict[float, float] = {}
        self._initial = initial_volume(morph)

    def wanted_volume(self, time: float) -> float:
        """V(t), in units of length to the power d."""
        return self.morph.wanted_volume(time, self._initial)

    def __call__(self, time: float) -> float:
        """The level at a time, in units of length where f is a distance; found once.

        Raises:
            InputError: if the surface leaves the box then, or no level encloses the volume.
        """
        if time not in self.levels:
            field = partial(self.morph, t=time)
            try:
                found = level_of_volume(field, self.morph.bounds, self.resolution, self.wanted_volume(time))
            except InputError as error:
                raise InputError(f"at t = {time:g} {error}") from error
            self.levels[time] = found
        return self.levels[time]

    @property
    def largest(self) -> float:
        """Greatest |c(t)| so far, 0 before the first."""
        return max(map(abs, self.levels.values()), default=0.0)

    @property
    def concern(self) -> str | None:
        """A sentence for people if some level so far was large, else None."""
        if self.largest <= LARGE_LEVEL:
            return None
        time = max(self.levels, key=lambda t: abs(self.levels[t]))
        return (
            f"at t = {time:g} the surface had to be moved by {self.levels[time]:.3g} to have the wanted volume (more "
            f"than {LARGE_LEVEL:g} shows): the morph itself does not keep it, so train it longer, or on another method"
        )


def initial_volume(morph: Morph) -> float:
    """Volume of {f(·, 0) < 0} in the domain of a morph, from fractions of cells (`nsm.geometry.volume`)."""
    return volume(partial(morph, t=0.0), morph.domain(0.0), VOLUME_RESOLUTION[morph.dim])
