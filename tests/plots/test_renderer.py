"""The renderer of surfaces: refinement, camera, light, and machines without OpenGL."""

from __future__ import annotations

import logging
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from problems import MOTIONS, Ball, LinearMotion

from nsm.geometry.meshing import extract_surface
from nsm.geometry.refinement import refine_bends
from nsm.geometry.topology import component_count
from nsm.metrics import VolumeCurve
from nsm.plots import opengl
from nsm.plots.camera import place_camera
from nsm.plots.lighting import Lighting
from nsm.plots.look import Look, facing
from nsm.plots.strip import render_strip, try_strip
from nsm.train.callbacks import Strip, Trackers

COARSE = Look(resolution=32)


def test_a_normal_that_faces_inwards_is_that_of_its_triangles() -> None:
    mesh = extract_surface(lambda x: Ball(3).jet(x).value, torch.tensor([[-1.0] * 3, [1.0] * 3]), 16)
    normals = mesh.vertices / mesh.vertices.norm(dim=1, keepdim=True)
    torn = normals.clone()
    torn[::7] *= -1
    torn[1::7] = 0
    mended = facing(torn, mesh)
    assert (mended * normals).sum(1).min() > 0.98
    assert torch.equal(facing(normals, mesh), normals)


@pytest.mark.parametrize("name", ["rotating_box", "squashed_ball"])
def test_bends_are_refined_without_gaps_and_onto_the_surface(name: str) -> None:
    motion = MOTIONS[name](3)
    field, gradient = partial(motion, t=0.3), partial(motion.gradient, t=0.3)
    coarse = extract_surface(field, motion.bounds, 20)
    fine, normals = refine_bends(coarse, field, gradient)
    assert len(fine.simplices) > 1.5 * len(coarse.simplices)
    # every directed edge once, and once the other way: closed, and turned the same everywhere
    edges = torch.cat([fine.simplices[:, [i, (i + 1) % 3]] for i in range(3)])
    assert len(edges.unique(dim=0)) == len(edges)
    assert torch.equal(edges.unique(dim=0), edges.flip(1).unique(dim=0))
    assert len(fine.vertices) - len(edges) // 2 + len(fine.simplices) == 2
    assert component_count(fine) == 1
    assert normals.norm(dim=1) == pytest.approx(1.0)

    def off_surface(mesh):
        return float(field(mesh.vertices[mesh.simplices].mean(1)).abs().mean())

    assert off_surface(fine) < 0.8 * off_surface(coarse)


def test_a_camera_holds_the_shape_at_every_angle() -> None:
    points = np.array([[0.9, 0.1, 0.0], [-0.3, -0.4, 0.2], [0.0, 0.5, -0.7]])
    camera = place_camera(points, (0.5, 0.4, 1.0), (0, 1, 0), aspect=0.5, turning=True)
    assert camera.aspect == pytest.approx(0.5)
    for angle in np.linspace(0, 2 * math.pi, 13):
        assert np.abs(camera.on_picture(camera.turned(points, angle))).max() < 1
    assert camera.turned(points, 2 * math.pi) == pytest.approx(points)
    assert camera.turned(points, 1.0)[:, 1] == pytest.approx(points[:, 1])
    closer = place_camera(points, (0.5, 0.4, 1.0), (0, 1, 0), zoom=2.0, aspect=0.5, turning=True)
    assert closer.half_width == pytest.approx(camera.half_width / 2)


@pytest.mark.parametrize("height", [0.5, 1.0])
def test_the_shadow_of_a_ball_is_the_form_factor_of_a_sphere(height: float) -> None:
    """A ball of radius r, its middle h above a floor, takes r² h / D³ of the light at a distance D from its middle."""
    radius = 0.5
    motion = LinearMotion(Ball(3, radius))
    mesh = extract_surface(motion.source, motion.bounds, 48)
    vertices = mesh.vertices.numpy() + np.array([0, height, 0])
    camera = place_camera(vertices, (0, 0.5, 1), (0, 1, 0))
    along = np.linspace(0.3, 3.0, 12)
    points = np.stack([along, np.zeros(12), 0.3 * along], 1)
    distance = np.linalg.norm(points - [0, height, 0], axis=1)
    shadow = Lighting(vertices, mesh.simplices.numpy(), camera).floor_shadow(points)
    assert shadow == pytest.approx(radius**2 * height / distance**3, abs=0.03)


def test_a_convex_surface_is_lit_by_all_that_is_above_it() -> None:
    motion = LinearMotion(Ball(3, 0.5))
    mesh = extract_surface(motion.source, motion.bounds, 48)
    points = mesh.vertices.numpy()
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    camera = place_camera(points, (0, 0.5, 1), (0, 1, 0))
    light = Lighting(points, mesh.simplices.numpy(), camera).light(points, normals)
    top, side, bottom = (light.ambient[np.argmin(np.abs(normals[:, 1] - up))] for up in (1.0, 0.0, -1.0))
    assert 0.85 < top <= 1.0
    assert bottom < side < top
    assert bottom > 0.4
    # nothing shadows a ball but itself: neighbors are lit alike, without noise
    edges = mesh.simplices[:, :2].numpy()
    assert np.abs(light.ambient[edges[:, 0]] - light.ambient[edges[:, 1]]).max() < 0.06


@pytest.fixture
def _no_opengl(monkeypatch: pytest.MonkeyPatch):
    """As where VTK finds no library: the process that tries is killed."""
    monkeypatch.setattr(opengl, "_TRIAL", "import os; os.abort()")
    opengl.require_opengl.cache_clear()
    yield
    opengl.require_opengl.cache_clear()


@pytest.mark.usefixtures("_no_opengl")
def test_without_opengl_the_packages_are_named(tmp_path: Path) -> None:
    with pytest.raises(opengl.NoOpenGLError, match="apt-get install libegl1 libgl1-mesa-dri"):
        render_strip(tmp_path / "strip.png", LinearMotion(Ball(3)), [0.0], size=40, look=COARSE)
    assert not list(tmp_path.iterdir())
    render_strip(tmp_path / "strip.png", LinearMotion(Ball(2)), [0.0], size=40, look=COARSE)


@pytest.mark.usefixtures("_no_opengl")
def test_without_opengl_training_goes_on(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert not try_strip(tmp_path / "strip.png", LinearMotion(Ball(3)), [0.0], size=40)
    curve = VolumeCurve(torch.zeros(1), torch.ones(1))
    with caplog.at_level(logging.WARNING):
        caplog.clear()
        Strip(str(tmp_path), [0.0], 40).write(LinearMotion(Ball(3)), curve, "run", Trackers([], step=0))
    assert [record.message.split(". ")[0] for record in caplog.records] == [f"Skipped {tmp_path / 'strip.png'}"]
    assert not list(tmp_path.iterdir())
