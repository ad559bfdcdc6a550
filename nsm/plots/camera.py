"""An orthographic camera, under which shapes have the same size at all times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nsm.cli.errors import InputError
from nsm.cli.settings import positive

#: Direction towards the camera and direction up, unless others are given.
VIEW, UP = (0.55, 0.45, 1.0), (0.0, 1.0, 0.0)
#: Margins around the shape, as factors; the shadow on the floor in front of it needs a larger one.
_ACROSS, _ALONG, _FLOOR_IN_FRONT = 1.15, 1.08, 0.12
#: Least width of a picture relative to its height where the shape determines it, so that the shadow fits in.
_NARROWEST = 0.7
#: Least height of a picture relative to its width where the shape determines it.
_FLATTEST = 0.4
#: Angles at which a turning shape must fit into the picture.
_ANGLES = 24


class Camera(NamedTuple):
    """Orthographic view of a shape that may turn about its vertical axis.

    Attributes:
        center: Point in the middle of the picture, shape (3,).
        axes: Directions to the right, up, and towards the viewer, as rows of shape (3, 3).
        half_width, half_height: Distances from the middle of the picture to its edges, in units of length.
        vertical: Unit vector upwards in space, shape (3,).
        axis: Point on the vertical axis about which shapes turn, shape (3,).
        floor: Height of the floor along ``vertical``.
    """

    center: np.ndarray
    axes: np.ndarray
    half_width: float
    half_height: float
    vertical: np.ndarray
    axis: np.ndarray
    floor: float

    @property
    def aspect(self) -> float:
        """Height of the picture divided by its width."""
        return self.half_height / self.half_width

    def on_picture(self, points: np.ndarray) -> np.ndarray:
        """Project points (n, 3) to the picture (n, 2): 0 in its middle, ±1 at its edges, to the right and upwards."""
        seen = (points - self.center) @ self.axes[:2].T
        return seen / np.array([self.half_width, self.half_height])

    def turn(self, angle: float) -> np.ndarray:
        """Return the matrix (3, 3) of a rotation about the vertical by an angle in radians (formula of Rodrigues)."""
        x, y, z = self.vertical
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross

    def turned(self, points: np.ndarray, angle: float) -> np.ndarray:
        """Rotate points (n, 3) about the vertical axis by an angle in radians."""
        return (points - self.axis) @ self.turn(angle).T + self.axis


def place_camera(
    points: np.ndarray,
    view: Sequence[float],
    up: Sequence[float],
    zoom: float = 1.0,
    aspect: float | None = None,
    turning: bool = False,
) -> Camera:
    """Place a camera so that all given points of a shape are in the picture, and a floor below all of them.

    Args:
        points: Points of the shape at all its times, shape (n, 3).
        view: Direction towards the viewer, shape (3,).
        up: Direction upwards, shape (3,).
        zoom: Magnification of the shape; at 1 it fills the picture.
        aspect: Height of the picture divided by its width; by default the shape determines it.
        turning: Whether the shape must fit at every angle about the vertical.

    Raises:
        InputError: If the directions are parallel, or the zoom is not positive.

    >>> corners = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    >>> camera = place_camera(corners, VIEW, UP, aspect=0.5)
    >>> bool(np.abs(camera.on_picture(corners)).max() < 1)
    True
    """
    axes, vertical = _axes(view, up)
    positive("zoom", zoom)
    if not len(points):
        points = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    axis = (points.min(0) + points.max(0)) / 2
    camera = Camera(np.zeros(3), axes, 1.0, 1.0, vertical, axis, float((points @ vertical).min()))
    if turning:
        angles = np.arange(_ANGLES) * 2 * math.pi / _ANGLES
        points = np.concatenate([camera.turned(points, angle) for angle in angles])
    seen = points @ axes.T
    lowest, highest = seen.min(0), seen.max(0)
    width, height = (highest - lowest)[:2] / 2
    radius = _ACROSS * max(width, _NARROWEST * height)
    needed = max(_ALONG * height + _FLOOR_IN_FRONT * radius, 1e-6)
    if aspect is None:
        aspect = max(needed / radius, _FLATTEST)
    half_height = max(needed, aspect * _ACROSS * width) / zoom
    return camera._replace(
        center=(lowest + highest) / 2 @ axes, half_width=float(half_height / aspect), half_height=float(half_height)
    )


def _axes(view: Sequence[float], up: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Directions right, up, and towards the viewer as rows (3, 3), and the unit vector (3,) upwards in space."""
    toward, vertical = np.asarray(view, float), np.asarray(up, float)
    if toward.shape != (3,) or vertical.shape != (3,) or np.linalg.norm(np.cross(vertical, toward)) < 1e-6:
        raise InputError(
            f"`view` and `up` must be two directions in space that are not parallel, got {list(view)} and {list(up)}. "
            "Try `view=[0.55,0.45,1] up=[0,1,0]`."
        )
    toward, vertical = toward / np.linalg.norm(toward), vertical / np.linalg.norm(vertical)
    right = np.cross(vertical, toward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(toward, right), toward]), vertical
