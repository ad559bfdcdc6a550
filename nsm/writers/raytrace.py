"""A small renderer for smooth surfaces: rays against triangles, on any machine, without a display.

A matt surface stands on a white floor in a bright room: the light of the room reaches a point from every direction
that is not blocked (ambient occlusion), and one large lamp adds shape. Rays are traced by Embree (Wald et al., 2014).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from scipy.ndimage import gaussian_filter

#: Samples along an edge of a pixel, and for each of them rays to the room and to the lamp.
_SUPERSAMPLES = 3
_ROOM_RAYS = 6
_LAMP_RAYS = 3
#: Rays to the room from a sample of the floor, whose light is smoothed over this share of the picture.
_FLOOR_RAYS = 2
_FLOOR_BLUR = 0.012
#: Half the width of the lamp as seen from the surface, in radians: how soft shadows are.
_LAMP_RADIUS = 0.22
#: How much of the light comes from the room, the lamp, and from a weak lamp opposite.
_ROOM, _LAMP, _FILL = 0.58, 0.62, 0.10
#: How dark the shadow on the floor may get.
_FLOOR_SHADOW = 0.6
#: Shadow too faint to show: it would reach the rim of the picture.
_FLOOR_LEAST = 0.12


class Camera(NamedTuple):
    """Looks at ``centre`` from ``direction``; ``radius`` to its left and right fills the picture."""

    centre: np.ndarray
    radius: float
    direction: np.ndarray
    up: np.ndarray
    #: Height of the floor along ``up``.
    floor: float
    #: Height of the picture as a share of its width.
    aspect: float = 1.0

    @property
    def axes(self) -> np.ndarray:
        """Right, up and towards the viewer, as rows (3, 3)."""
        toward = self.direction / np.linalg.norm(self.direction)
        right = np.cross(self.up, toward)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(toward, right), toward])


class Scene:
    """Triangles with a normal at each vertex.

    Args:
        vertices: (v, 3).
        triangles: (m, 3) indices.
        normals: (v, 3) unit normals, interpolated over the triangles.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, normals: np.ndarray) -> None:
        self._triangles, self._normals = triangles, normals
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(
            self._scene,
            np.ascontiguousarray(vertices, dtype=np.float32),
            np.ascontiguousarray(triangles, dtype=np.int32),
        )

    def hit(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where rays (n, 3) meet the surface first: a mask (n,), distances and unit normals of those that do."""
        found = self._scene.run(origins, directions, output=True)
        mask = found["primID"] >= 0
        corners = self._triangles[found["primID"][mask]]
        u, v = found["u"][mask, None], found["v"][mask, None]
        normals = (1 - u - v) * self._normals[corners[:, 0]] + u * self._normals[corners[:, 1]]
        normals += v * self._normals[corners[:, 2]]
        return mask, found["tfar"][mask], normals / np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-12)

    def blocked(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Whether each of n rays meets the surface anywhere (n,)."""
        return self._scene.run(origins, directions, query="OCCLUDED") >= 0


def render(scene: Scene | None, camera: Camera, size: int, colour: tuple[float, float, float]) -> np.ndarray:
    """Picture (aspect · size, size, 3) of a scene in 0 … 1, sRGB; of the bare floor where there is none.

    Args:
        scene: what to show.
        camera: from where.
        size: pixels across.
        colour: of the surface, linear RGB in 0 … 1.
    """
    height = max(1, round(size * camera.aspect))
    if scene is None:
        return np.ones((height, size, 3), dtype=np.float32)
    rng = np.random.default_rng(0)  # the same noise in every picture: a strip does not flicker
    origins, direction = _view_rays(camera, (height * _SUPERSAMPLES, size * _SUPERSAMPLES), rng)
    origins = origins.reshape(-1, 3)
    directions = np.broadcast_to(direction, origins.shape).astype(np.float32)
    light = np.ones((len(origins), 3), dtype=np.float32)

    mask, distance, normals = scene.hit(origins, directions)
    points = origins[mask] + distance[:, None] * directions[mask]
    light[mask] = np.asarray(colour) * _shade(scene, camera, points, normals, rng)[:, None]

    if direction @ camera.up < 0:
        hidden = mask.reshape(height * _SUPERSAMPLES, size * _SUPERSAMPLES)
        light[~mask] = _floor(scene, camera, origins[~mask], direction, hidden, rng)[:, None]
    pixels = light.reshape(height, _SUPERSAMPLES, size, _SUPERSAMPLES, 3).mean((1, 3))
    return np.clip(pixels, 0, 1) ** (1 / 2.2)


def _floor(
    scene: Scene,
    camera: Camera,
    origins: np.ndarray,
    direction: np.ndarray,
    hidden: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Light of the floor where it is not ``hidden``: white paper, darker under the surface, white again at the rim.

    Args:
        scene: what throws the shadow.
        camera: from where.
        origins: of the rays that see the floor (n, 3).
        direction: of all rays.
        hidden: (rows, columns), where rays do not see the floor; n of them do.
        rng: noise.

    Returns:
        Light (n,) in 0 … 1.
    """
    up = camera.up / np.linalg.norm(camera.up)
    depth = (camera.floor - origins @ up) / (direction @ up)
    ground = (origins + depth[:, None] * direction).astype(np.float32)
    seen = ~hidden
    openness = np.zeros(seen.shape)
    openness[seen] = _openness(scene, camera, ground, np.broadcast_to(up, ground.shape), rng, _FLOOR_RAYS)
    width = _FLOOR_BLUR * seen.shape[1]
    smooth = gaussian_filter(openness, width) / gaussian_filter(seen.astype(float), width).clip(1e-6)
    shadow = np.clip(1 - smooth - _FLOOR_LEAST, 0, None) / (1 - _FLOOR_LEAST)
    down, across = (np.clip((1 - np.abs(np.linspace(-1, 1, count))) / 0.4, 0, 1) for count in seen.shape)
    rim = (np.sqrt(3 - 2 * down) * down)[:, None] * (across**2 * (3 - 2 * across))
    return 1 - _FLOOR_SHADOW * (rim * shadow)[seen]


def _view_rays(camera: Camera, shape: tuple[int, int], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Origins (rows, columns, 3) of parallel rays, jittered in their cells, from above down, and their direction."""
    right, up, toward = camera.axes
    rows, columns = shape
    jitter = rng.random((2, rows, columns))
    across = (np.arange(columns)[None, :] + jitter[0]) / columns * 2 - 1
    along = camera.aspect * (1 - (np.arange(rows)[:, None] + jitter[1]) / rows * 2)
    plane = across[..., None] * right + along[..., None] * up
    origins = camera.centre + camera.radius * (plane + 4 * toward)
    return origins.astype(np.float32), -toward.astype(np.float32)


def _shade(
    scene: Scene, camera: Camera, points: np.ndarray, normals: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Light (n,) that a matt surface sends back."""
    right, _, toward = camera.axes
    room_up = camera.up / np.linalg.norm(camera.up)
    lamp = 0.55 * toward + 0.9 * room_up - 0.55 * right
    lamp /= np.linalg.norm(lamp)
    fill = 0.5 * toward - 0.1 * room_up + 0.9 * right
    fill /= np.linalg.norm(fill)
    facing = (normals @ lamp).clip(0)
    lit = np.zeros(len(points))
    turned = facing > 0
    start = _off(points, normals, camera)[turned]
    for _ in range(_LAMP_RAYS):
        toward_lamp = lamp + _LAMP_RADIUS * _in_ball(int(turned.sum()), rng)
        lit[turned] += ~scene.blocked(start, toward_lamp.astype(np.float32)) / _LAMP_RAYS
    openness = _openness(scene, camera, points, normals, rng, _ROOM_RAYS)
    # the room is a little brighter above than below
    room = openness * (0.75 + 0.25 * (normals @ room_up))
    return _ROOM * room + _LAMP * facing * lit + _FILL * (normals @ fill).clip(0) * openness


def _openness(
    scene: Scene, camera: Camera, points: np.ndarray, normals: np.ndarray, rng: np.random.Generator, rays: int
) -> np.ndarray:
    """Share of the light of a bright room that reaches points (n,), by rays with a cosine about the normal."""
    start = _off(points, normals, camera)
    free = np.zeros(len(points))
    for _ in range(rays):
        # a unit normal plus a point on the unit sphere is distributed as the cosine
        sphere = rng.standard_normal((len(points), 3), dtype=np.float32)
        sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
        free += ~scene.blocked(start, (normals + 0.999 * sphere).astype(np.float32))
    return free / rays


def _off(points: np.ndarray, normals: np.ndarray, camera: Camera) -> np.ndarray:
    """Points moved off the surface, so that a ray does not meet the triangle it starts from."""
    return (points + 4e-3 * camera.radius * normals).astype(np.float32)


def _in_ball(count: int, rng: np.random.Generator) -> np.ndarray:
    """Points (count, 3) spread evenly in directions, at most 1 from the origin."""
    points = rng.standard_normal((count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True) * rng.random((count, 1)) ** (1 / 3)
