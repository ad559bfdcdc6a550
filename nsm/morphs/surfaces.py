"""Surface of a morph at one time, at its zero level or at the level of exact volume."""

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
from nsm.shapes.base import VOLUME_RESOLUTION
from nsm.types import Morph, SimplexMesh

log = logging.getLogger(__name__)

#: Maps a time to the level of f to extract.
Levels = Callable[[float], float]


class Frame(NamedTuple):
    """Surface {f(·, time) = level} with the normals ∇f/‖∇f‖ at its vertices, shape (v, d)."""

    time: float
    level: float
    mesh: SimplexMesh
    normals: Float[Tensor, "v d"]


@torch.no_grad()
def extract_frame(morph: Morph, time: float, resolution: int, level: float = 0.0) -> Frame:
    """Extract the surface at one time, and log a warning if it leaves the domain of the morph.

    Args:
        morph: The morph.
        time: Time in [0, 1].
        resolution: Cells along the longest edge of ``morph.bounds``.
        level: Value of f on the surface.

    Example:
        >>> from nsm.fields import ScalarSiren
        >>> from nsm.morphs.neural import NeuralMorph
        >>> from nsm.shapes import Ball
        >>> morph = NeuralMorph(ScalarSiren(4, 8, 1), None, Ball(0.4), Ball(0.5)).requires_grad_(False)
        >>> extract_frame(morph, 0.5, resolution=16).mesh.vertices.shape[1]
        3
    """
    mesh = extract_surface(partial(morph, t=time), morph.bounds, resolution, level)
    if sides := open_sides(mesh, morph.domain(time)):
        log.warning(
            "At t = %g the surface leaves the box through its sides %s and is cut off there. Try smaller shapes, "
            "`source.pose.scale=0.9 target.pose.scale=0.9`, or enlarge `morph.bounds` in Python.",
            time,
            ", ".join(sides),
        )
    return Frame(time, level, mesh, normalize(morph.gradient(mesh.vertices, time), dim=1))


def zero_level(time: float) -> float:
    """Level 0, the surface of f itself."""
    return 0.0


class ExactVolume:
    """Levels c(t) at which the extracted mesh encloses the wanted volume, Vol{f(·, t) < c(t)} = V(t).

    V(t) is `nsm.types.Morph.wanted_volume` for the volume at t = 0 (`initial_volume`), and `nsm.geometry.level` finds
    the level at which the volume of the mesh equals it.

    Args:
        morph: The morph.
        resolution: Cells along the longest edge of ``morph.bounds`` with which the surface is extracted.

    Attributes:
        levels: Levels found so far, by time.
    """

    def __init__(self, morph: Morph, resolution: int) -> None:
        self.morph, self.resolution = morph, resolution
        self.levels: dict[float, float] = {}
        self._initial = initial_volume(morph)

    def wanted_volume(self, time: float) -> float:
        """V(t) in units of length to the power d."""
        return self.morph.wanted_volume(time, self._initial)

    def __call__(self, time: float) -> float:
        """Find the level at a time, in units of length where f is a distance; later calls return the same value.

        Raises:
            InputError: If the surface leaves the box at that time, or no level encloses the volume.
        """
        if time not in self.levels:
            field = partial(self.morph, t=time)
            try:
                found = level_of_volume(field, self.morph.bounds, self.resolution, self.wanted_volume(time))
            except InputError as error:
                raise InputError(f"At t = {time:g}: {error}") from error
            self.levels[time] = found
        return self.levels[time]


def initial_volume(morph: Morph) -> float:
    """Volume of {f(·, 0) < 0} in the domain of a morph, from fractions of cells (`nsm.geometry.volume`)."""
    return volume(partial(morph, t=0.0), morph.domain(0.0), VOLUME_RESOLUTION[morph.dim])
