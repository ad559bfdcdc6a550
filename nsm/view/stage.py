"""The stage of the page: places for shapes side by side on a floor, in even light, before the renderer's camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
import viser
from jaxtyping import Float

from nsm.geometry.meshing import extract_surface
from nsm.plots.camera import UP, VIEW, place_camera
from nsm.types import Morph

#: Cells along the box, and times, of the surfaces that determine the extent of a morph before any picture is made.
_ROUGH_RESOLUTION, _ROUGH_TIMES = 24, (0.0, 0.25, 0.5, 0.75, 1.0)
#: Distance between shapes in widths of the widest, and from a shape to its name in heights of the tallest.
_PITCH, _GAP = 1.2, 0.05
#: Direction from the shapes to the camera, and angle in radians by which shapes are turned about the vertical. Together
#: they show each shape as rendered pictures do, and none is farther away than the others.
_VIEW = {2: (0.0, 0.0, 1.0), 3: (0.0, VIEW[1], math.hypot(VIEW[0], VIEW[2]))}
_TURN = {2: 0.0, 3: -math.atan2(VIEW[0], VIEW[2])}
#: Vertical angle of the camera, small because the renderer has no perspective, and width divided by height of the
#: window in which all shapes fit.
_ANGLE, _ASPECT = math.radians(20), 1.45
#: Colors of the fine and the coarse grid on the floor.
_GRID, _SECTION = (238, 240, 243), (224, 228, 233)


class Extent(NamedTuple):
    """Lowest and highest corner (3,) of the box around a shape at all times."""

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

    def corners(self) -> Float[np.ndarray, "8 3"]:
        """Return the corners of the box."""
        return np.stack(np.meshgrid(*zip(self.low, self.high, strict=True)), -1).reshape(-1, 3)

    def turned(self, angle: float) -> Extent:
        """Return the box around this one after a rotation about the vertical axis by an angle in radians."""
        corners = self.corners() @ _rotation(angle).T
        return Extent(corners.min(0), corners.max(0))


class Stage:
    """Places for shapes on the page, side by side, each with a name above it and a caption below, and nothing else.

    Nodes added below `folder` are in the coordinates of that shape.

    Args:
        server: Server of the page.
        names: Names of the shapes.
        extents: Extents of the shapes.
        dim: Dimension of space.
    """

    def __init__(self, server: viser.ViserServer, names: Sequence[str], extents: Sequence[Extent], dim: int) -> None:
        self.server = server
        server.scene.reset()
        self._turn = _rotation(_TURN[dim])
        extents = [extent.turned(_TURN[dim]) for extent in extents]
        size = np.max([extent.high - extent.low for extent in extents], axis=0)
        floor, top = min(e.low[1] for e in extents), max(e.high[1] for e in extents)
        gap = _GAP * size[1]
        self._captions: list[viser.LabelHandle] = []
        self._places: list[np.ndarray] = []
        seen = []
        for number, (name, extent) in enumerate(zip(names, extents, strict=True)):
            place = (number - (len(names) - 1) / 2) * _PITCH * size[0] - (extent.low[0] + extent.high[0]) / 2
            self._places.append(np.array([place, 0.0, 0.0]))
            self._add_folder(number, dim)
            self._add_labels(number, name, extent, (floor - gap / 2, top + gap))
            labeled = Extent(extent.low.copy(), extent.high.copy())
            labeled.low[1], labeled.high[1] = floor - gap, top + 2 * gap
            seen.append(labeled.corners() + self._places[-1])
        server.scene.set_up_direction("+y")
        server.scene.configure_default_lights(enabled=True, cast_shadow=dim == 3)
        server.scene.configure_environment_map("studio", environment_intensity=0.25)
        if dim == 3:
            self._lay_floor(floor, float(size.max()) * len(names))
        self._aim(np.concatenate(seen), dim)

    @staticmethod
    def folder(number: int) -> str:
        """Name of the node whose coordinates are those of a shape."""
        return f"/shape_{number}/turned"

    def caption(self, number: int, text: str) -> None:
        """Change the caption below a shape."""
        self._captions[number].text = text

    def ray(
        self, number: int, origin: Float[np.ndarray, " 3"], direction: Float[np.ndarray, " 3"]
    ) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Map the origin and direction of a ray on the page to the coordinates of a shape."""
        return (origin - self._places[number]) @ self._turn, direction @ self._turn

    def _add_folder(self, number: int, dim: int) -> None:
        scene, (outer, _, _) = self.server.scene, self.folder(number).rpartition("/")
        scene.add_frame(outer, show_axes=False, position=tuple(self._places[number]))
        wxyz = (math.cos(_TURN[dim] / 2), 0.0, math.sin(_TURN[dim] / 2), 0.0)
        scene.add_frame(self.folder(number), show_axes=False, wxyz=wxyz)

    def _add_labels(self, number: int, name: str, extent: Extent, heights: tuple[float, float]) -> None:
        scene, outer = self.server.scene, self.folder(number).rpartition("/")[0]
        middle, (below, above) = (extent.low + extent.high) / 2, heights
        position = (middle[0], above, extent.low[2])  # behind the shape, where the camera from above sees nothing of it
        scene.add_label(f"{outer}/name", name, position=position, anchor="bottom-center", font_screen_scale=1.15)
        position = (middle[0], below, extent.high[2])
        caption = scene.add_label(
            f"{outer}/caption", " ", position=position, anchor="top-center", font_screen_scale=0.95
        )
        self._captions.append(caption)

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

    def _aim(self, points: Float[np.ndarray, "n 3"], dim: int) -> None:
        """Look as the renderer does, from so far that all points are in the picture, now and on every new page."""
        wanted = place_camera(points, _VIEW[dim], UP, aspect=1 / _ASPECT)
        depth = float(((points - wanted.center) @ wanted.axes[2]).max())
        position = wanted.center + wanted.axes[2] * (wanted.half_height / math.tan(_ANGLE / 2) + depth)
        first = self.server.initial_camera
        first.up, first.fov, first.position, first.look_at = UP, _ANGLE, position, wanted.center
        for client in self.server.get_clients().values():
            with client.atomic():
                client.camera.up_direction, client.camera.fov = UP, _ANGLE
                client.camera.position, client.camera.look_at = position, wanted.center


def _rotation(angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation about the vertical axis by an angle in radians."""
    return np.array([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
