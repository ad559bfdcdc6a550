"""One frame as the page shows it: the surface in its colors, and the figures beside it."""

from __future__ import annotations

from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.topology import component_count, enclosed_volume
from nsm.geometry.volume import volume
from nsm.morphs.surfaces import ExactVolume, extract_frame
from nsm.plots.colors import RESIDUALS, carried_colors, residual_colors
from nsm.types import Morph, SimplexMesh
from nsm.view.flat import filled, ribbon
from nsm.view.glb import glb

#: What the colors of a surface can say, by what the page calls it.
COLORS = {
    "clay": "clay",
    "level_set": "level-set residual",
    "eikonal": "Eikonal residual",
    "carried": "carried from t = 0",
}
#: sRGB of a surface without more to say, of a 2D shape's inside, and of its outline.
_CLAY, _INSIDE, _OUTLINE = (0.68, 0.76, 0.89), (0.80, 0.86, 0.94), (0.16, 0.24, 0.38)
#: Points that are carried for the colors of a frame, and from how many of them a vertex takes its own.
_CARRIED, _NEIGHBORS = 2000, 4
#: Distance at which a vertex is one of them.
_AT_A_POINT = 1e-6
#: Cells along the box for volumes: for smooth shapes, good to some 1e-4 of the volume.
VOLUME_RESOLUTION = {2: 256, 3: 64}


class Settings(NamedTuple):
    """What all frames on the page have in common.

    Attributes:
        resolution: cells along the box.
        exact: whether each frame shows the level of exactly the wanted volume.
        offset: the value of f on the surface, beyond that level.
        color: a key of `COLORS`.
    """

    resolution: int = 96
    exact: bool = False
    offset: float = 0.0
    color: str = "clay"

    def check(self, morphs: list[Morph]) -> None:
        """Look whether morphs can be shown so.

        Raises:
            InputError: if the color is not known, or none of the morphs has the velocity that it needs.
        """
        if self.color not in COLORS:
            raise InputError(f"color={self.color} is not known: give one of {', '.join(COLORS)}")
        if not any(can_color(morph, self.color) for morph in morphs):
            raise InputError(f"color={self.color} needs a velocity, which no morph here has: give color=eikonal")


class Surface(NamedTuple):
    """The surface at one time and what is measured on it.

    Attributes:
        mesh: triangles, segments in 2D.
        normals: ∇f/‖∇f‖ (v, d) at its vertices.
        level: the value of f on it.
        volume: inside (area in 2D), in units of length to the power d.
        deviation: of the volume from the wanted one, relative to it.
        components: how many pieces there are.
    """

    mesh: SimplexMesh
    normals: Tensor
    level: float
    volume: float
    deviation: float
    components: int


class Picture(NamedTuple):
    """A surface with its triangles as the page takes them, ``None`` where there is no surface."""

    surface: Surface
    glb: bytes | None

    @property
    def size(self) -> int:
        """Bytes that it takes."""
        mesh = self.surface.mesh
        return mesh.vertices.nbytes + self.surface.normals.nbytes + mesh.simplices.nbytes + len(self.glb or b"")


class Photographer:
    """Makes pictures of one morph.

    Args:
        morph: the morph.
    """

    def __init__(self, morph: Morph) -> None:
        self.morph = morph
        self._exact: dict[int, ExactVolume] = {}

    @torch.no_grad()
    def surface(self, time: float, settings: Settings) -> Surface:
        """Extract and measure the surface at a time from 0 to 1."""
        level = settings.offset + (self._exact_volume(settings.resolution)(time) if settings.exact else 0.0)
        _, _, mesh, normals = extract_frame(self.morph, time, settings.resolution, level)
        mesh = SimplexMesh(mesh.vertices, mesh.simplices.int())  # half the memory
        # frames of exact volume are exact as the meshes they are; otherwise the field is what counts
        inside = enclosed_volume(mesh) if settings.exact else self._volume(time, level)
        return Surface(mesh, normals, level, inside, inside / self.wanted_volume(time) - 1, component_count(mesh))

    @torch.no_grad()
    def picture(self, surface: Surface, time: float, settings: Settings) -> Picture:
        """Color a surface of this morph."""
        mesh = surface.mesh
        if not len(mesh.simplices):
            return Picture(surface, None)
        colors = self._colors(mesh.vertices, time, settings.color)
        if self.morph.dim == 3:
            plain = np.tile(_CLAY, (len(mesh.vertices), 1)) if colors is None else colors
            points, normals, faces = (a.cpu().numpy() for a in (mesh.vertices, surface.normals, mesh.simplices))
            return Picture(surface, glb(points, normals, faces, plain))
        inside, area = filled(mesh, partial(self.morph, t=time), surface.level)
        band, strip = ribbon(mesh, float((self.morph.bounds[1] - self.morph.bounds[0]).max()))
        line = np.tile(_OUTLINE, (len(band), 1)) if colors is None else _at_corners(colors, mesh)
        return Picture(
            surface,
            glb(
                np.concatenate([inside, band]),
                np.tile((0.0, 0.0, 1.0), (len(inside) + len(band), 1)),
                np.concatenate([area, strip + len(inside)]),
                np.concatenate([np.tile(_INSIDE, (len(inside), 1)), line]),
            ),
        )

    def wanted_volume(self, time: float) -> float:
        """The volume that the morph should have: that at t = 0, times its growth."""
        return self.morph.wanted_volume(time, self._initial_volume)

    @cached_property
    def _initial_volume(self) -> float:
        return self._volume(0.0, 0.0)

    def _volume(self, time: float, level: float) -> float:
        def field(x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
            return self.morph(x, time) - level

        return volume(field, self.morph.bounds, VOLUME_RESOLUTION[self.morph.dim])

    def _exact_volume(self, resolution: int) -> ExactVolume:
        if resolution not in self._exact:
            self._exact[resolution] = ExactVolume(self.morph, resolution)
        return self._exact[resolution]

    def _colors(self, points: Tensor, time: float, color: str) -> Float[np.ndarray, "v 3"] | None:
        """Colors of the vertices, None for plain clay."""
        if color == "clay" or not can_color(self.morph, color):
            return None
        if color != "carried":
            return residual_colors(self.morph, points, time, color).cpu().double().numpy()
        return self._carried(points, time)

    def _carried(self, points: Tensor, time: float) -> Float[np.ndarray, "v 3"]:
        """Colors of some of the points, spread to their neighbors: to carry all of them takes ten times as long."""
        few = points[:: max(1, len(points) // _CARRIED)]
        known = carried_colors(self.morph, few, time).cpu().double().numpy()
        tree = cKDTree(few.cpu().double().numpy())
        distance, nearest = tree.query(points.cpu().double().numpy(), k=min(_NEIGHBORS, len(few)))
        distance, nearest = distance.reshape(len(points), -1), nearest.reshape(len(points), -1)
        weights = 1 / (distance + _AT_A_POINT)
        return (weights[..., None] * known[nearest]).sum(1) / weights.sum(1, keepdims=True)


def can_color(morph: Morph, color: str) -> bool:
    """Whether a morph has what a color shows; without it, it is shown in clay."""
    return color in ("clay", "eikonal") or morph.has_velocity


def scale_of(color: str) -> float:
    """The residual that has the last color."""
    return RESIDUALS[color][1]


def _at_corners(colors: np.ndarray, mesh: SimplexMesh) -> np.ndarray:
    """Colors of the vertices of `ribbon`, from those of the segments' ends."""
    return colors[mesh.simplices.cpu().numpy()].repeat(2, axis=1).reshape(-1, 3)
