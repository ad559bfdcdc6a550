"""Pictures of surfaces: a matt shape on white paper, in the light of a bright room."""

from __future__ import annotations

from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, zoom

from nsm.cli.extras import require
from nsm.plots.camera import Camera
from nsm.plots.light import Room
from nsm.plots.opengl import require_opengl

#: Pixels between points of the floor, the fewest and the most of these in a row, and how many a shadow is blurred over.
_FLOOR_STEP, _FLOOR_POINTS, _FLOOR_BLUR = 5, (24, 192), 1.6
#: How dark the shadow on the floor may get.
_FLOOR_SHADOW = 0.55
#: Shadow too faint to show: it would reach the rim of the picture.
_FLOOR_LEAST = 0.06
#: Part of the picture, from its rim, over which the shadow fades.
_RIM = 0.4
#: Views less steep than this (the sine of their angle to the floor) show no floor.
_LEAST_SLOPE = 0.05
#: Light on the inner side of a surface, which is seen where it is open.
_INSIDE = 0.3
#: Light from here to white is compressed, so that bright colors keep their shades.
_SHOULDER = 0.75
#: Exponent that takes linear light to sRGB.
_GAMMA = 1 / 2.2
#: The camera stands this many half heights away, well in front of any shape.
_DISTANCE = 20.0
#: Samples along an edge of a pixel, and samples in each of these.
_SUPERSAMPLES, _MULTISAMPLES = 2, 4


class Surface(NamedTuple):
    """Triangles to draw.

    Attributes:
        vertices: (v, 3).
        triangles: (m, 3) indices, counter-clockwise seen from outside.
        normals: unit normals (v, 3).
        colors: (v, 3), sRGB in 0 … 1.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    colors: np.ndarray


class Studio:
    """Draws surfaces of one camera's view, one after the other; a context that frees the graphics at its end.

    Args:
        camera: from where.
        width: of pictures in pixels; the height follows from the camera.

    Raises:
        MissingPackageError: if the packages that draw are not installed.
        NoOpenGLError: if this machine cannot draw.
    """

    def __init__(self, camera: Camera, width: int) -> None:
        require("pyvista", extra="render", task="A picture of a surface")
        require_opengl()
        import pyvista  # takes half a second, which commands that draw nothing save

        self._camera, self.size = camera, (width, max(1, round(width * camera.aspect)))
        # of any type: its methods are wrapped in ways that type checkers misread
        self._pyvista: Any = pyvista
        window = [_SUPERSAMPLES * pixels for pixels in self.size]
        self._plotter = self._pyvista.Plotter(off_screen=True, window_size=window, lighting="none")
        self._plotter.set_background("white")
        self._plotter.enable_anti_aliasing("msaa", multi_samples=_MULTISAMPLES)
        view = self._plotter.camera
        view.focal_point = camera.center
        view.position = camera.center + _DISTANCE * camera.half_height * camera.axes[2]
        view.up = camera.axes[1]
        view.parallel_projection = True
        view.parallel_scale = camera.half_height
        view.clipping_range = (0.01 * _DISTANCE * camera.half_height, 2 * _DISTANCE * camera.half_height)
        # the same in every picture: films do not flicker
        self._grain = np.random.default_rng(0).random((self.size[1], self.size[0], 1), dtype=np.float32)

    def __enter__(self) -> Studio:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the graphics."""
        self._plotter.close()

    def draw(self, surface: Surface) -> np.ndarray:
        """Picture (height, width, 3) of a surface, 8 bits of sRGB; of white paper where it has no triangles."""
        if not len(surface.triangles):
            return np.full((*self.size[::-1], 3), 255, dtype=np.uint8)
        room = Room(surface.vertices, surface.triangles, self._camera)
        seen = _seen(surface, self._camera)
        linear = surface.colors ** (1 / _GAMMA)
        light = _INSIDE * linear
        light[seen] = room.light(surface.vertices[seen], surface.normals[seen]).reflected(linear[seen])
        picture = self._pixels(surface, _compressed(light) ** _GAMMA)
        colors, cover = picture[..., :3], picture[..., 3:] / 255
        # the shape is drawn over white: what is missing of white is the shadow, where the shape does not cover it
        shadow = self._floor(room)[..., None]
        dimmed = colors - 255 * (1 - cover) * shadow
        # rounded at random, or steps of a faint shadow are seen as lines
        return np.where(shadow > 0, dimmed + self._grain, colors + 0.5).clip(0, 255).astype(np.uint8)

    def _pixels(self, surface: Surface, colors: np.ndarray) -> np.ndarray:
        """Red, green, blue over white and opacity (height, width, 4), 0 … 255, of triangles by colors (v, 3)."""
        mesh = self._pyvista.PolyData.from_regular_faces(surface.vertices, surface.triangles)
        mesh.point_data["light"] = np.round(255 * colors).astype(np.uint8)
        self._plotter.add_mesh(
            mesh,
            name="surface",
            scalars="light",
            rgb=True,
            lighting=False,
            copy_mesh=False,
            reset_camera=False,
            render=False,
            show_scalar_bar=False,
        )
        self._plotter.render()
        return _reduced(np.asarray(self._plotter.screenshot(return_img=True, transparent_background=True)))

    def _floor(self, room: Room) -> np.ndarray:
        """What the shadow takes from white paper (height, width), 0 … 1 in sRGB; nothing towards the rim."""
        camera, (width, height) = self._camera, self.size
        slope = float(camera.axes[2] @ camera.vertical)
        if slope < _LEAST_SLOPE:
            return np.zeros((height, width), dtype=np.float32)
        columns = int(np.clip(width // _FLOOR_STEP, *_FLOOR_POINTS))
        rows = max(8, round(columns * camera.aspect))
        across, along = np.linspace(-1, 1, columns), np.linspace(1, -1, rows)
        right, up, toward = camera.axes
        plane = camera.half_width * across[:, None] * right + camera.half_height * along[:, None, None] * up
        points = (camera.center + plane).reshape(-1, 3)
        points = points + ((camera.floor - points @ camera.vertical) / slope)[:, None] * toward
        rim = _fade(along)[:, None] * _fade(across)
        inner = rim.ravel() > 0
        shadow = np.zeros(len(points))
        shadow[inner] = room.floor_shadow(points[inner])
        smooth = gaussian_filter(shadow.reshape(rows, columns), _FLOOR_BLUR)
        light = 1 - _FLOOR_SHADOW * rim * (smooth - _FLOOR_LEAST).clip(0) / (1 - _FLOOR_LEAST)
        taken = (1 - light**_GAMMA).astype(np.float32)
        fine = zoom(taken, (height / rows, width / columns), order=1, grid_mode=True, mode="nearest")
        return fine.clip(0, 1)


def _seen(surface: Surface, camera: Camera) -> np.ndarray:
    """Which vertices belong to a triangle that faces the viewer."""
    corners = surface.vertices[surface.triangles]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    seen = np.zeros(len(surface.vertices), dtype=bool)
    seen[surface.triangles[outward @ camera.axes[2] > 0]] = True
    return seen


def _compressed(light: np.ndarray) -> np.ndarray:
    """Light below 1: as it is up to the shoulder, and ever less beyond."""
    room = 1 - _SHOULDER
    return np.where(light > _SHOULDER, _SHOULDER + room * np.tanh((light - _SHOULDER) / room), light)


def _fade(place: np.ndarray) -> np.ndarray:
    """1 in the middle of −1 … 1 and 0 at both ends, smoothly."""
    inward = np.clip((1 - np.abs(place)) / _RIM, 0, 1)
    return inward**2 * (3 - 2 * inward)


def _reduced(large: np.ndarray) -> np.ndarray:
    """Means over the samples of each pixel, all channels."""
    n = _SUPERSAMPLES
    total = np.zeros((large.shape[0] // n, large.shape[1] // n, large.shape[2]), dtype=np.uint16)
    for row in range(n):
        for column in range(n):
            total += large[row::n, column::n]
    return total.astype(np.float32) / (n * n)
