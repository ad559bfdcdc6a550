"""Light on a matte surface, and the shadow on the floor below it, computed point by point.

Ambient light comes from all directions, brighter from above than from below, where the surface does not block it
(ambient occlusion). A large lamp adds direct light with soft shadows. Both are sums over fixed directions, the same at
every point: neighboring points and successive times receive almost the same light, so pictures are free of noise and
films do not flicker. Embree traces the rays.

References:
    Wald et al., Embree: a kernel framework for efficient CPU ray tracing, 2014, https://doi.org/10.1145/2601097.2601199
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

#: Directions of ambient light (all around), and directions to the lamp.
_AMBIENT_RAYS, _LAMP_RAYS = 288, 48
#: Half the width of the lamp as seen from the surface, in radians; shadows are softer the larger it is.
_LAMP_RADIUS = 0.3
#: Intensity of the ambient light, of the lamp, and of a weak lamp opposite.
_AMBIENT, _LAMP, _FILL = 0.50, 0.74, 0.08
#: Ambient light from the zenith, from the horizon, and from below, where the floor reflects it.
_ZENITH, _HORIZON, _BELOW = 1.0, 0.75, 0.5
#: Distance from the surface at which rays start, relative to half the height of the picture, so that they miss the
#: triangle that they leave.
_OFF = 1.5e-3


class Light(NamedTuple):
    """Light that arrives at points.

    Attributes:
        ambient: Share of the ambient light that is not blocked, shape (n,).
        direct: Intensity of the light from the lamps, shape (n,).
    """

    ambient: np.ndarray
    direct: np.ndarray

    def reflected(self, color: np.ndarray) -> np.ndarray:
        """Return the light (n, 3) that a surface of the given color, (n, 3) or (3,), reflects; both in linear RGB.

        In a crease, blocked ambient light is partly replaced by light from the surrounding surface, which has its
        color: a / (1 − c (1 − a)) for ambient light a and color c.

        References:
            Jimenez et al., Practical real-time strategies for accurate indirect occlusion, 2016,
            https://www.activision.com/cdn/research/PracticalRealtimeStrategiesTRfinal.pdf
        """
        ambient = self.ambient[:, None]
        return color * (_AMBIENT * ambient / (1 - color * (1 - ambient.clip(0, 1))) + self.direct[:, None])


class Lighting:
    """Illumination of one surface.

    Args:
        vertices: Vertices of the surface, shape (v, 3).
        triangles: Indices of their corners, shape (m, 3).
        camera: The camera, beside which the lamps stand.
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
        """Compute the light at points (n, 3) of the surface with unit normals (n, 3)."""
        around = _sphere(_AMBIENT_RAYS)
        upwards = around @ self._camera.vertical
        above = _HORIZON + (_ZENITH - _HORIZON) * upwards
        bright = np.where(upwards > 0, above, _BELOW)
        # divided by the sum of weights at each point, so that few rays suffice on an unobstructed plane
        free, whole = self._gather(points, normals, around, bright)
        lit, all_lit = self._gather(points, normals, _disc(self._lamp, _LAMP_RADIUS, _LAMP_RAYS), None)
        ambient = free / whole.clip(1e-9)
        facing = (normals @ self._lamp).clip(0)
        lamp = facing * lit / all_lit.clip(1e-9)
        return Light(ambient, _LAMP * lamp + _FILL * (normals @ self._fill).clip(0) * ambient)

    def floor_shadow(self, points: np.ndarray) -> np.ndarray:
        """Return the share of light (n,) that the surface takes from points (n, 3) of the floor, 0 in the open."""
        normals = np.broadcast_to(self._camera.vertical, points.shape)
        free, whole = self._gather(points, normals, _sphere(2 * _AMBIENT_RAYS), None)
        return 1 - free / whole

    def _gather(
        self, points: np.ndarray, normals: np.ndarray, directions: np.ndarray, bright: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Σ b cos θ over the unobstructed directions, and Σ cos θ over all, at each point."""
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
    """Sum the results of ``work`` for shares of the numbers below ``count``; Embree releases the interpreter lock."""
    workers = min(count, torch.get_num_threads())
    with ThreadPoolExecutor(workers) as pool:
        parts = list(pool.map(work, [np.arange(first, count, workers) for first in range(workers)]))
    return sum(part[0] for part in parts), sum(part[1] for part in parts)  # type: ignore[return-value]


def _sphere(count: int) -> np.ndarray:
    """Unit vectors (count, 3) spread evenly on a spiral that turns by the golden angle (Fibonacci sphere)."""
    number = np.arange(count) + 0.5
    height = 1 - 2 * number / count
    angle = math.pi * (3 - math.sqrt(5)) * number
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(angle), height, ring * np.sin(angle)], 1)


def _disc(middle: np.ndarray, radius: float, count: int) -> np.ndarray:
    """Unit vectors (count, 3) spread evenly within an angle of about ``radius`` around one, on the same spiral."""
    number = np.arange(count) + 0.5
    angle, distance = math.pi * (3 - math.sqrt(5)) * number, radius * np.sqrt(number / count)
    first = _unit(np.cross(middle, np.eye(3)[np.abs(middle).argmin()]))
    second = np.cross(middle, first)
    spread = (distance * np.cos(angle))[:, None] * first + (distance * np.sin(angle))[:, None] * second
    return _unit(middle + spread)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
