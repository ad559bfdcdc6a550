"""The scene on the page: morphs side by side on a floor, in even light."""

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
from nsm.plots.camera import VIEW
from nsm.types import Morph
from nsm.view.pictures import Settings
from nsm.view.store import Key

#: Cells along the box, and times, of the surfaces that determine the extent of a morph before any picture is made.
_ROUGH_RESOLUTION, _ROUGH_TIMES = 24, (0.0, 0.25, 0.5, 0.75, 1.0)
#: Distance between morphs in widths of the widest, and from a shape to its name in heights of the tallest.
_PITCH, _GAP = 1.2, 0.05
#: Direction from the morphs to the camera, and angle in radians by which morphs are turned about the vertical. Together
#: they show each morph as rendered pictures do, and none is farther away than the others.
_VIEW = {2: (0.0, 0.0, 1.0), 3: (0.0, VIEW[1], math.hypot(VIEW[0], VIEW[2]))}
_TURN = {2: 0.0, 3: -math.atan2(VIEW[0], VIEW[2])}
#: Vertical angle of the camera, and width divided by height of the window in which all morphs fit.
_ANGLE, _ASPECT = math.radians(30), 1.45
#: Margin around the morphs, as a factor.
_MARGIN = 1.06
#: Colors of the fine and the coarse grid on the floor.
_GRID, _SECTION = (238, 240, 243), (224, 228, 233)


class Extent(NamedTuple):
    """Lowest and highest corner (3,) of the box around a morph's surface at all times."""

    low: Float[np.ndarray, " 3"]
    high: Float[np.ndarray, " 3"]

    @classmethod
    @torch.no_grad()
    def of(cls, morph: Morph) -> Extent:
        """Estimate the extent of a morph from coarse surfaces at a few times; its whole box if it has none."""
        surfaces = [
            extract_surface(partial(morph, t=time), morph.bounds, _ROUGH_RESOLUTION).vertices for time in _ROUGH_TIMES
        ]
        found = torch.cat(surfaces)
        points = (found if len(found) else morph.bounds).cpu().double().numpy()
        flat = np.zeros((len(points), 3))
        flat[:, : morph.dim] = points
        return cls(flat.min(0), flat.max(0))

    def turned(self, angle: float) -> Extent:
        """Return the box around this one after a rotation about the vertical axis by an angle in radians."""
        turn = np.array([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
        corners = np.stack(np.meshgrid(*zip(self.low, self.high, strict=True)), -1).reshape(-1, 3) @ turn.T
        return Extent(corners.min(0), corners.max(0))


class Scene:
    """Scene of a page: every picture is a node of its own, of which one per morph is visible.

    The browser receives pictures before they are shown, so that one replaces another at once and nothing flickers.

    Args:
        server: Server of the page.
        names: Names of the morphs.
        extents: Extents of the morphs.
        dim: Dimension of space.
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
        """Keys of the visible pictures."""
        return set(self._shown.values())

    def add(self, key: Key, content: bytes | None) -> None:
        """Send a picture to the browser, where it stays hidden until `show` selects it."""
        if content is not None:
            number = self._settings.setdefault(key.settings, len(self._settings))
            name = f"{self._folder(key.morph)}/turned/settings_{number}/{key.time}"
            self._nodes[key] = self.server.scene.add_glb(name, content, visible=False)

    def remove(self, keys: Sequence[Key]) -> None:
        """Remove pictures from the browser."""
        for key in keys:
            if (node := self._nodes.pop(key, None)) is not None:
                node.remove()

    def show(self, keys: Mapping[int, Key], captions: Mapping[int, str]) -> None:
        """Replace the visible picture and caption of each given morph, all at once."""
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
