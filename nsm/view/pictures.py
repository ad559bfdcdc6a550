"""Pictures for the page: the surface at one time in its colors, with the figures measured on it."""

from __future__ import annotations

from functools import cached_property, partial
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.topology import component_count, enclosed_volume
from nsm.geometry.volume import volume
from nsm.io.gltf import encode_glb
from nsm.morphs.surfaces import ExactVolume, extract_frame
from nsm.plots.colors import NEED_VELOCITY, clay_colors, color_function
from nsm.types import Morph, SimplexMesh
from nsm.view.flat import encode_flat


class Settings(NamedTuple):
    """Settings shared by all pictures on the page.

    Attributes:
        resolution: Cells along the box.
        exact: Whether each surface is the level set that encloses exactly the wanted volume.
        offset: Value of f on the surface, added to that level.
        color: Key of `nsm.plots.colors.COLORS`.
    """

    resolution: int = 96
    exact: bool = False
    offset: float = 0.0
    color: str = "clay"

    def check(self, morphs: list[Morph]) -> None:
        """Require that at least one of the morphs can be shown in this color.

        Raises:
            InputError: If the color is unknown, or none of the morphs has the velocity that it needs.
        """
        color_function(self.color)
        if not any(can_color(morph, self.color) for morph in morphs):
            raise InputError(
                f"`color={self.color}` must be given a morph with a velocity, got none. Try `color=eikonal`."
            )


class Surface(NamedTuple):
    """Surface at one time, and what is measured on it.

    Attributes:
        mesh: Triangles in 3D, segments in 2D.
        normals: ∇f/‖∇f‖ at its vertices, shape (v, d).
        level: Value of f on it.
        volume: Volume inside, or area in 2D, in units of length to the power d.
        deviation: Relative deviation of the volume from the wanted one.
        components: Number of connected components.
    """

    mesh: SimplexMesh
    normals: Tensor
    level: float
    volume: float
    deviation: float
    components: int


class Picture(NamedTuple):
    """Surface, and its triangles as the page receives them: bytes of a GLB file, None if there is no surface."""

    surface: Surface
    glb: bytes | None

    @property
    def size(self) -> int:
        """Memory in bytes."""
        mesh = self.surface.mesh
        return mesh.vertices.nbytes + self.surface.normals.nbytes + mesh.simplices.nbytes + len(self.glb or b"")


class PictureMaker:
    """Extracts, measures, and colors the surfaces of one morph.

    Args:
        morph: The morph.
    """

    def __init__(self, morph: Morph) -> None:
        self.morph = morph
        self._exact: dict[int, ExactVolume] = {}

    @torch.no_grad()
    def surface(self, time: float, settings: Settings) -> Surface:
        """Extract and measure the surface at a time in [0, 1]."""
        level = settings.offset + (self._exact_volume(settings.resolution)(time) if settings.exact else 0.0)
        _, _, mesh, normals = extract_frame(self.morph, time, settings.resolution, level)
        mesh = SimplexMesh(mesh.vertices, mesh.simplices.int())  # half the memory
        # meshes of exact volume are measured as they are; otherwise the field is more accurate
        inside = enclosed_volume(mesh) if settings.exact else self._volume(time, level)
        return Surface(mesh, normals, level, inside, inside / self.wanted_volume(time) - 1, component_count(mesh))

    @torch.no_grad()
    def picture(self, surface: Surface, time: float, settings: Settings) -> Picture:
        """Color a surface of this morph."""
        if not len(surface.mesh.simplices):
            return Picture(surface, None)
        # a morph that lacks the velocity for this color is shown in clay
        name = settings.color if can_color(self.morph, settings.color) else "clay"
        if self.morph.dim == 2:
            return Picture(surface, self._flat(surface, time, name))
        colors = color_function(name)(self.morph, surface.mesh.vertices, time)
        return Picture(surface, encode_glb(surface.mesh, surface.normals, colors))

    def wanted_volume(self, time: float) -> float:
        """Volume that the morph should have at a time, given that at t = 0."""
        return self.morph.wanted_volume(time, self._initial_volume)

    @cached_property
    def _initial_volume(self) -> float:
        return self._volume(0.0, 0.0)

    def _volume(self, time: float, level: float) -> float:
        def field(x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
            return self.morph(x, time) - level

        return volume(field, self.morph.bounds)

    def _exact_volume(self, resolution: int) -> ExactVolume:
        if resolution not in self._exact:
            self._exact[resolution] = ExactVolume(self.morph, resolution)
        return self._exact[resolution]

    def _flat(self, surface: Surface, time: float, color: str) -> bytes:
        """A 2D shape: its inside in one color, its outline in the colors of its points."""
        mesh, edge = surface.mesh, float((self.morph.bounds[1] - self.morph.bounds[0]).max())
        colors_of = color_function(color)
        colors = None if colors_of is clay_colors else colors_of(self.morph, mesh.vertices, time)
        return encode_flat(mesh, partial(self.morph, t=time), surface.level, edge, colors).glb


def can_color(morph: Morph, color: str) -> bool:
    """Tell whether a morph has what a color shows."""
    return color not in NEED_VELOCITY or morph.has_velocity
