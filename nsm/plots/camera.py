"""Where pictures are taken from: parallel rays, so that shapes have the same size at all times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nsm.cli.errors import InputError

#: Room around the shape, as a factor; the floor in front needs more of it than the air above.
_ACROSS, _ALONG, _FLOOR_IN_FRONT = 1.15, 1.08, 0.12
#: Width of a picture that chooses its own, as a share of its height at least: the shadow needs some.
_NARROWEST = 0.7
#: Height of a picture that chooses its own, as a share of its width at least.
_FLATTEST = 0.4
#: Turns at which the camera of a turning shape looks whether all of it is in the picture.
_TURNS_SEEN = 24


class Camera(NamedTuple):
    """Parallel rays of sight onto a shape that may turn about its upright axis.

    Attributes:
        center: in the middle of the picture (3,).
        axes: right, up and towards the viewer, as rows (3, 3).
        half_width, half_height: from the middle of the picture to its edges, in units of length.
        vertical: unit vector (3,) upwards in space.
        axis: a point (3,) on the upright axis about which shapes turn.
        floor: height of the floor along ``vertical``.
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
        """Height of the picture as a share of its width."""
        return self.half_height / self.half_width

    def on_picture(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) as (n, 2) from the middle of the picture, ±1 at its edges, to the right and upwards."""
        seen = (points - self.center) @ self.axes[:2].T
        return seen / np.array([self.half_width, self.half_height])

    def turn(self, angle: float) -> np.ndarray:
        """The matrix (3, 3) that turns directions by an angle in radians about the vertical."""
        x, y, z = self.vertical
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross

    def turned(self, points: np.ndarray, angle: float) -> np.ndarray:
        """Points (n, 3) turned about the axis."""
        return (points - self.axis) @ self.turn(angle).T + self.axis


def place_camera(
    points: np.ndarray,
    view: Sequence[float],
    up: Sequence[float],
    zoom: float = 1.0,
    aspect: float | None = None,
    turning: bool = False,
) -> Camera:
    """A camera that holds points (n, 3) of a shape at all times, on a floor below all of them.

    Args:
        points: (n, 3).
        view: direction (3,) towards the viewer.
        up: direction (3,) upwards.
        zoom: enlarges the shape; at 1 it fills the picture.
        aspect: height of the picture as a share of its width; by the shape where None.
        turning: whether the shape turns about the vertical, and shall be held at every angle.

    Raises:
        InputError: for directions or a zoom that show nothing.
    """
    axes, vertical = _axes(view, up)
    if not zoom > 0:
        raise InputError(f"zoom={zoom} shows nothing: give a number above 0, such as 1")
    if not len(points):
        points = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    axis = (points.min(0) + points.max(0)) / 2
    camera = Camera(np.zeros(3), axes, 1.0, 1.0, vertical, axis, float((points @ vertical).min()))
    if turning:
        angles = np.arange(_TURNS_SEEN) * 2 * math.pi / _TURNS_SEEN
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
    """Right, up and towards the viewer as rows (3, 3), and the unit vector (3,) upwards in space."""
    toward, vertical = np.asarray(view, float), np.asarray(up, float)
    if toward.shape != (3,) or vertical.shape != (3,) or np.linalg.norm(np.cross(vertical, toward)) < 1e-6:
        raise InputError(
            f"view={list(view)} and up={list(up)} place no camera: give two directions of three numbers that are not "
            "parallel, such as view=[0.55,0.45,1] up=[0,1,0]"
        )
    toward, vertical = toward / np.linalg.norm(toward), vertical / np.linalg.norm(vertical)
    right = np.cross(vertical, toward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(toward, right), toward]), vertical
