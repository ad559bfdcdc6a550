"""What is seen: morphs side by side on a floor, in a bright studio."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
import viser
from jaxtyping import Float

from nsm.geometry.meshing import extract_surface
from nsm.types import Morph
from nsm.view.frames import Settings
from nsm.view.store import Key

#: Cells and times by which the morphs' places are found before any frame is there.
_ROUGH_RESOLUTION, _ROUGH_TIMES = 24, (0.0, 0.25, 0.5, 0.75, 1.0)
#: From one morph to the next, in widths of the widest; from a shape to its name, in heights of the highest.
_PITCH, _GAP = 1.2, 0.05
#: The direction of the camera from the morphs: in 3D from above, in 2D straight. Morphs in 3D are turned about the
#: upright by this angle, so that each is seen a little from the side and none is farther away.
_VIEW = {2: (0.0, 0.0, 1.0), 3: (0.0, 0.18, 1.0)}
_TURN = {2: 0.0, 3: math.radians(22)}
#: Vertical angle of the camera, narrow as for a portrait; width over height of the picture that must hold all.
_ANGLE, _ASPECT = math.radians(30), 1.45
#: Room around what the camera holds.
_MARGIN = 1.06
_GRID, _SECTION = (238, 240, 243), (224, 228, 233)


class Extent(NamedTuple):
    """Corners (3,) of the box that a morph's surface keeps to at all times."""

    low: Float[np.ndarray, " 3"]
    high: Float[np.ndarray, " 3"]

    @classmethod
    @torch.no_grad()
    def of(cls, morph: Morph) -> Extent:
        """Look at a morph roughly, at a few times; its whole box where it has no surface."""
        surfaces = [
            extract_surface(partial(morph, t=time), morph.bounds, _ROUGH_RESOLUTION).vertices for time in _ROUGH_TIMES
        ]
        found = torch.cat(surfaces)
        points = (found if len(found) else morph.bounds).cpu().double().numpy()
        flat = np.zeros((len(points), 3))
        flat[:, : morph.dim] = points
        return cls(flat.min(0), flat.max(0))

    def turned(self, angle: float) -> Extent:
        """The box around this one when it is turned about the upright axis, in radians."""
        turn = np.array([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
        corners = np.stack(np.meshgrid(*zip(self.low, self.high, strict=True)), -1).reshape(-1, 3) @ turn.T
        return Extent(corners.min(0), corners.max(0))


class Stage:
    """The scene of a page: every picture is a node of its own, of which one a morph is visible.

    The browser has all pictures before they are shown, so that one replaces another at once and nothing flickers.

    Args:
        server: of the page.
        names: of the morphs.
        extents: of the morphs.
        dim: dimension of space.
    """

    def __init__(self, server: viser.ViserServer, names: Sequence[str], extents: Sequence[Extent], dim: int) -> None:
        self.server = server
        self._nodes: dict[Key, viser.GlbHandle] = {}
        self._shown: dict[int, Key] = {}
        self._settings: dict[Settings, int] = {}
        extents = [extent.turned(_TURN[dim]) for extent in extents]
        size = np.max([extent.high - extent.low for extent in extents], axis=0)
        floor, top = min(e.low[1] for e in extents), max(e.high[1] for e in extents)
        gap = _GAP * size[1]
        self._captions = []
        for number, (name, extent) in enumerate(zip(names, extents, strict=True)):
            place = (number - (len(names) - 1) / 2) * _PITCH * size[0] - (extent.low[0] + extent.high[0]) / 2
            server.scene.add_frame(self._folder(number), show_axes=False, position=(place, 0.0, 0.0))
            wxyz = (math.cos(_TURN[dim] / 2), 0.0, math.sin(_TURN[dim] / 2), 0.0)
            server.scene.add_frame(f"{self._folder(number)}/turned", show_axes=False, wxyz=wxyz)
            middle = (extent.low + extent.high) / 2
            above, below = (middle[0], top + gap, middle[2]), (middle[0], floor - gap / 2, extent.high[2])
            server.scene.add_label(
                f"{self._folder(number)}/name", name, position=above, anchor="bottom-center", font_screen_scale=1.15
            )
            caption = server.scene.add_label(
                f"{self._folder(number)}/caption", " ", position=below, anchor="top-center", font_screen_scale=0.95
            )
            self._captions.append(caption)
        server.scene.set_up_direction("+y")
        self._light(dim)
        if dim == 3:
            self._lay_floor(floor, float(size.max()) * len(names))
        width = ((len(names) - 1) * _PITCH + 1) * size[0]
        self._aim(np.array([0.0, (floor + top) / 2, 0.0]), float(width), float(top - floor + 3 * gap), size[2], dim)

    @property
    def shown(self) -> set[Key]:
        """The pictures that are visible now."""
        return set(self._shown.values())

    def add(self, key: Key, content: bytes | None) -> None:
        """Send a picture to the browser, where it stays hidden until it is shown."""
        if content is not None:
            number = self._settings.setdefault(key.settings, len(self._settings))
            name = f"{self._folder(key.morph)}/turned/settings_{number}/{key.time}"
            self._nodes[key] = self.server.scene.add_glb(name, content, visible=False)

    def remove(self, keys: Sequence[Key]) -> None:
        """Take pictures back."""
        for key in keys:
            if (node := self._nodes.pop(key, None)) is not None:
                node.remove()

    def show(self, keys: Mapping[int, Key], captions: Mapping[int, str]) -> None:
        """Show one picture of each morph in place of that before, with a line below it, all at once."""
        with self.server.atomic():
            for morph, key in keys.items():
                before = self._shown.get(morph)
                if before == key:
                    continue
                for other, visible in ((before, False), (key, True)):
                    if other is not None and other in self._nodes:
                        self._nodes[other].visible = visible
                self._shown[morph] = key
            for morph, text in captions.items():
                self._captions[morph].text = text

    @staticmethod
    def _folder(morph: int) -> str:
        return f"/morph_{morph}"

    def _light(self, dim: int) -> None:
        scene = self.server.scene
        scene.configure_default_lights(enabled=True, cast_shadow=dim == 3)
        scene.configure_environment_map("studio", environment_intensity=0.25)

    def _lay_floor(self, height: float, width: float) -> None:
        self.server.scene.add_grid(
            "/floor",
            plane="xz",
            infinite_grid=True,
            cell_size=0.5,
            section_size=1.0,
            cell_color=_GRID,
            section_color=_SECTION,
            fade_distance=6 * width,
            fade_from="origin",
            shadow_opacity=0.16,
            position=(0.0, height, 0.0),
        )

    def _aim(self, middle: np.ndarray, width: float, height: float, depth: float, dim: int) -> None:
        half = _MARGIN * max(height, width / _ASPECT) / 2
        view = np.array(_VIEW[dim]) / np.linalg.norm(_VIEW[dim])
        camera = self.server.initial_camera
        camera.up = (0.0, 1.0, 0.0)
        camera.fov = _ANGLE
        camera.look_at = middle
        camera.position = middle + view * (half / math.tan(_ANGLE / 2) + depth / 2)
