"""Offscreen renderer of matte surfaces with soft light and a shadow on a white floor."""

from __future__ import annotations

from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, zoom

from nsm.cli.extras import require
from nsm.plots.camera import Camera
from nsm.plots.lighting import Lighting
from nsm.plots.opengl import require_opengl

#: Pixels between sample points of the floor, fewest and most of these in a row, and width of the blur in points.
_FLOOR_STEP, _FLOOR_POINTS, _FLOOR_BLUR = 5, (24, 192), 1.6
#: Darkness of the shadow on the floor where it is complete.
_FLOOR_SHADOW = 0.55
#: Shadow below this is not drawn, because it would reach the rim of the picture.
_FLOOR_LEAST = 0.06
#: Part of the picture, measured from its rim, over which the shadow fades.
_RIM = 0.4
#: Sine of the angle to the floor below which no floor is drawn.
_LEAST_SLOPE = 0.05
#: Light on the inner side of a surface, which is visible where the surface is open.
_INSIDE = 0.3
#: Light above this is compressed towards white, so that bright colors keep their shading.
_SHOULDER = 0.75
#: Exponent from linear light to sRGB.
_GAMMA = 1 / 2.2
#: Distance of the camera in half heights of the picture, well in front of any shape.
_DISTANCE = 20.0
#: Samples along an edge of a pixel, and samples in each of these.
_SUPERSAMPLES, _MULTISAMPLES = 2, 4


class Surface(NamedTuple):
    """Triangles to draw.

    Attributes:
        vertices: Vertices, shape (v, 3).
        triangles: Indices of the corners, counter-clockwise seen from outside, shape (m, 3).
        normals: Unit normals at the vertices, shape (v, 3).
        colors: Colors of the vertices, sRGB in 0..1, shape (v, 3).
    """

    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    colors: np.ndarray


class SurfaceRenderer:
    """Renders surfaces as one camera sees them; a context manager that frees the graphics at its end.

    Args:
        camera: The camera.
        width: Width of pictures in pixels; the height follows from the camera.

    Raises:
        MissingPackageError: If pyvista is not installed.
        NoOpenGLError: If this machine cannot draw.
    """

    def __init__(self, camera: Camera, width: int) -> None:
        require("pyvista", extra="render", task="A picture of a surface")
        require_opengl()
        import pyvista  # takes half a second, which commands that draw nothing should not pay

        self._camera, self.size = camera, (width, max(1, round(width * camera.aspect)))
        # typed as Any: its methods are wrapped in ways that type checkers misread
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
        # the same in every picture, so that films do not flicker
        self._grain = np.random.default_rng(0).random((self.size[1], self.size[0], 1), dtype=np.float32)

    def __enter__(self) -> SurfaceRenderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the graphics."""
        self._plotter.close()

    def draw(self, surface: Surface) -> np.ndarray:
        """Render a surface as sRGB pixels of 8 bits (height, width, 3), all white if it has no triangles."""
        if not len(surface.triangles):
            return np.full((*self.size[::-1], 3), 255, dtype=np.uint8)
        lighting = Lighting(surface.vertices, surface.triangles, self._camera)
        visible = _facing_camera(surface, self._camera)
        linear = surface.colors ** (1 / _GAMMA)
        light = _INSIDE * linear
        light[visible] = lighting.light(surface.vertices[visible], surface.normals[visible]).reflected(linear[visible])
        picture = self._pixels(surface, _compressed(light) ** _GAMMA)
        colors, cover = picture[..., :3], picture[..., 3:] / 255
        # the shape is drawn over white; where it does not cover the floor, the shadow takes its share of white
        shadow = self._floor(lighting)[..., None]
        dimmed = colors - 255 * (1 - cover) * shadow
        # rounded at random: otherwise the steps of a faint shadow appear as lines
        return np.where(shadow > 0, dimmed + self._grain, colors + 0.5).clip(0, 255).astype(np.uint8)

    def _pixels(self, surface: Surface, colors: np.ndarray) -> np.ndarray:
        """Draw triangles with given colors (v, 3); returns RGB over white and opacity (height, width, 4) in 0..255."""
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

    def _floor(self, lighting: Lighting) -> np.ndarray:
        """Darkness of the shadow on the white floor (height, width), 0..1 in sRGB, fading to 0 at the rim."""
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
        shadow[inner] = lighting.floor_shadow(points[inner])
        smooth = gaussian_filter(shadow.reshape(rows, columns), _FLOOR_BLUR)
        light = 1 - _FLOOR_SHADOW * rim * (smooth - _FLOOR_LEAST).clip(0) / (1 - _FLOOR_LEAST)
        taken = (1 - light**_GAMMA).astype(np.float32)
        fine = zoom(taken, (height / rows, width / columns), order=1, grid_mode=True, mode="nearest")
        return fine.clip(0, 1)


def _facing_camera(surface: Surface, camera: Camera) -> np.ndarray:
    """Mask (v,) of the vertices of triangles that face the camera."""
    corners = surface.vertices[surface.triangles]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    mask = np.zeros(len(surface.vertices), dtype=bool)
    mask[surface.triangles[outward @ camera.axes[2] > 0]] = True
    return mask


def _compressed(light: np.ndarray) -> np.ndarray:
    """Compress light above the shoulder smoothly to values below 1."""
    rest = 1 - _SHOULDER
    return np.where(light > _SHOULDER, _SHOULDER + rest * np.tanh((light - _SHOULDER) / rest), light)


def _fade(place: np.ndarray) -> np.ndarray:
    """Smooth step from 0 at both ends of −1..1 to 1 in the middle."""
    inward = np.clip((1 - np.abs(place)) / _RIM, 0, 1)
    return inward**2 * (3 - 2 * inward)


def _reduced(large: np.ndarray) -> np.ndarray:
    """Average the samples of each pixel, in all channels."""
    n = _SUPERSAMPLES
    total = np.zeros((large.shape[0] // n, large.shape[1] // n, large.shape[2]), dtype=np.uint16)
    for row in range(n):
        for column in range(n):
            total += large[row::n, column::n]
    return total.astype(np.float32) / (n * n)
