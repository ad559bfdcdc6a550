"""The light of a bright room on a matt surface and on the floor below it, point by point.

Light comes from all of the room, brighter above than below, where the surface does not block it (ambient occlusion),
and from a large lamp, whose shadows are soft. Both are sums over fixed directions, the same at every point: neighbors
see almost the same, so light is free of noise, and so do successive times, so films do not flicker. Rays are traced
by Embree (Wald et al., 2014).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import torch

from nsm.cli.extras import require
from nsm.plots.camera import Camera

#: Directions to the room (all around), and to the lamp.
_ROOM_RAYS, _LAMP_RAYS = 288, 48
#: Half the width of the lamp as seen from the surface, in radians: how soft shadows are.
_LAMP_RADIUS = 0.3
#: How much of the light comes from the room, the lamp, and from a weak lamp opposite.
_ROOM, _LAMP, _FILL = 0.50, 0.74, 0.08
#: Light from straight above and from the horizon, as shares of the brightest; below, the floor gives back what it gets.
_ZENITH, _HORIZON, _BELOW = 1.0, 0.75, 0.5
#: How far rays start from the surface, as a share of the height of the picture, not to meet the triangle they leave.
_OFF = 1.5e-3


class Light(NamedTuple):
    """What arrives at points: ``room`` (n,), the share of the room's light, and ``lamps`` (n,), of direct light."""

    room: np.ndarray
    lamps: np.ndarray

    def reflected(self, color: np.ndarray) -> np.ndarray:
        """Linear RGB (n, 3) from a surface of linear RGB (n, 3) or (3,).

        In a crease, light of the room that is blocked is partly replaced by light from the surface around, which has
        its color: room / (1 − color (1 − room)) (after Jimenez et al., Practical real-time strategies for accurate
        indirect occlusion, 2016).
        """
        room = self.room[:, None]
        return color * (_ROOM * room / (1 - color * (1 - room.clip(0, 1))) + self.lamps[:, None])


class Room:
    """A surface in the light.

    Args:
        vertices: (v, 3).
        triangles: (m, 3) indices.
        camera: the lamps stand beside the viewer.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, camera: Camera) -> None:
        self._camera, self._off = camera, _OFF * camera.half_height
        require("embreex", extra="render", task="The light of a picture")
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(
            self._scene,
            np.ascontiguousarray(vertices, dtype=np.float32),
            np.ascontiguousarray(triangles, dtype=np.int32),
        )
        right, _, toward = camera.axes
        self._lamp = _unit(0.55 * toward + 0.9 * camera.vertical - 0.55 * right)
        self._fill = _unit(0.5 * toward - 0.1 * camera.vertical + 0.9 * right)

    def light(self, points: np.ndarray, normals: np.ndarray) -> Light:
        """Light at points (n, 3) of the surface with unit normals (n, 3)."""
        around = _sphere(_ROOM_RAYS)
        upwards = around @ self._camera.vertical
        above = _HORIZON + (_ZENITH - _HORIZON) * upwards
        bright = np.where(upwards > 0, above, _BELOW)
        # normalized by all weights of a point, so that a plane in the open gets what it should in spite of few rays
        free, whole = self._gather(points, normals, around, bright)
        lit, all_lit = self._gather(points, normals, _disc(self._lamp, _LAMP_RADIUS, _LAMP_RAYS), None)
        room = free / whole.clip(1e-9)
        facing = (normals @ self._lamp).clip(0)
        lamp = facing * lit / all_lit.clip(1e-9)
        return Light(room, _LAMP * lamp + _FILL * (normals @ self._fill).clip(0) * room)

    def floor_shadow(self, points: np.ndarray) -> np.ndarray:
        """How much of the light (n,) is taken from points (n, 3) of the floor, 0 in the open."""
        normals = np.broadcast_to(self._camera.vertical, points.shape)
        free, whole = self._gather(points, normals, _sphere(2 * _ROOM_RAYS), None)
        return 1 - free / whole

    def _gather(
        self, points: np.ndarray, normals: np.ndarray, directions: np.ndarray, bright: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Σ cos b over the directions that are free, and Σ cos over all, at each point."""
        start = (points + self._off * normals).astype(np.float32)
        strength = np.ones(len(directions)) if bright is None else bright

        def along(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            free, whole = np.zeros(len(points)), np.zeros(len(points))
            for number in numbers:
                cosine = normals @ directions[number]
                faces = np.flatnonzero(cosine > 0)
                rays = np.broadcast_to(directions[number].astype(np.float32), (len(faces), 3)).copy()
                open_ = self._scene.run(start[faces], rays, query="OCCLUDED") < 0
                free[faces] += strength[number] * cosine[faces] * open_
                whole[faces] += cosine[faces]
            return free, whole

        return _in_threads(along, len(directions))


def _in_threads(
    work: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], count: int
) -> tuple[np.ndarray, np.ndarray]:
    """The sum of what ``work`` yields for shares of the numbers up to ``count``; Embree lets threads run at once."""
    workers = min(count, torch.get_num_threads())
    with ThreadPoolExecutor(workers) as pool:
        parts = list(pool.map(work, [np.arange(first, count, workers) for first in range(workers)]))
    return sum(part[0] for part in parts), sum(part[1] for part in parts)  # type: ignore[return-value]


def _sphere(count: int) -> np.ndarray:
    """Unit vectors (count, 3) spread evenly: a spiral that turns by the golden angle."""
    number = np.arange(count) + 0.5
    height = 1 - 2 * number / count
    angle = math.pi * (3 - math.sqrt(5)) * number
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(angle), height, ring * np.sin(angle)], 1)


def _disc(middle: np.ndarray, radius: float, count: int) -> np.ndarray:
    """Unit vectors (count, 3) spread evenly within an angle of about ``radius`` around one, on such a spiral."""
    number = np.arange(count) + 0.5
    angle, distance = math.pi * (3 - math.sqrt(5)) * number, radius * np.sqrt(number / count)
    first = _unit(np.cross(middle, np.eye(3)[np.abs(middle).argmin()]))
    second = np.cross(middle, first)
    spread = (distance * np.cos(angle))[:, None] * first + (distance * np.sin(angle))[:, None] * second
    return _unit(middle + spread)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
