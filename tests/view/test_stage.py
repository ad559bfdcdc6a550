"""Places of shapes on the page, and the camera that looks at them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
import viser

from nsm.plots.camera import UP, VIEW, place_camera
from nsm.view.server import open_page
from nsm.view.stage import Extent, Stage

SHAPES = [Extent(np.array([-0.9, -0.5, -0.3]), np.array([0.9, 0.5, 0.3])), Extent(-np.ones(3) / 2, np.ones(3) / 2)]


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    with open_page("127.0.0.1", None) as server:
        yield server


def unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector) / np.linalg.norm(vector)


@pytest.mark.parametrize("dim", [2, 3])
def test_every_shape_is_seen_from_where_the_renderer_sees_it(server: viser.ViserServer, dim: int) -> None:
    stage = Stage(server, ["a", "b"], SHAPES, dim)
    camera = server.initial_camera
    toward = unit(camera.position - camera.look_at)
    for number in range(2):
        _, direction = stage.ray(number, np.zeros(3), toward)
        assert direction == pytest.approx(unit(np.array(VIEW if dim == 3 else (0, 0, 1))))


def test_one_shape_is_framed_as_the_renderer_frames_it(server: viser.ViserServer) -> None:
    stage = Stage(server, ["a"], SHAPES[:1], 3)
    camera = server.initial_camera
    _, forward = stage.ray(0, np.zeros(3), unit(camera.position - camera.look_at))
    rendered = place_camera(SHAPES[0].corners(), VIEW, UP, aspect=1 / 1.45)
    assert forward == pytest.approx(rendered.axes[2])
    half = np.linalg.norm(camera.position - camera.look_at) * math.tan(camera.fov / 2)
    assert half == pytest.approx(rendered.half_height, rel=0.4)  # names, captions, and perspective take some room


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("count", [1, 2])
def test_all_shapes_are_in_the_picture(server: viser.ViserServer, dim: int, count: int) -> None:
    stage = Stage(server, ["a", "b"][:count], SHAPES[:count], dim)
    camera = server.initial_camera
    forward = unit(camera.look_at - camera.position)
    right = unit(np.cross(forward, (0, 1, 0)))
    up = np.cross(right, forward)
    seen = []
    for number, shape in enumerate(SHAPES[:count]):
        eye, _ = stage.ray(number, camera.position, forward)
        axes = [stage.ray(number, np.zeros(3), axis)[1] for axis in (right, up, forward)]
        across, along, depth = ((shape.corners() - eye) @ np.array(axes).T).T
        seen.append(np.stack([across / depth / 1.45, along / depth]) / math.tan(camera.fov / 2))
    assert np.abs(np.concatenate(seen, axis=-1)).max() < 1
