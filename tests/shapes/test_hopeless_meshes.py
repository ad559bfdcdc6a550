"""Meshes that bound no solid as they are: each gets the inside that it stands for, or one sentence why not."""

from __future__ import annotations

import logging
import math
import time
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from nsm.cli.errors import InputError
from nsm.shapes import Ball, Box, MeshFile
from nsm.shapes.mesh_repair import repaired

BALL = trimesh.creation.icosphere(3)
BOX = trimesh.creation.box((2, 2, 2)).subdivide().subdivide()


def _mesh(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices, faces, process=False)


def _joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(meshes))


def _at(mesh: trimesh.Trimesh, *place: float, scale: float = 1.0, inverted: bool = False) -> trimesh.Trimesh:
    moved = mesh.copy()
    moved.apply_scale(scale)
    moved.apply_translation(place)
    if inverted:
        moved.invert()
    return moved


def _shape(mesh: trimesh.Trimesh, tmp_path: Path) -> MeshFile:
    mesh.export(tmp_path / "a.ply")
    return MeshFile(str(tmp_path / "a.ply"), fit=None)


def _wall() -> trimesh.Trimesh:
    """The cross-section of `BOX` at x = 0, on its vertices."""
    sheet = trimesh.creation.box((2, 2, 2)).subdivide().subdivide()
    faces = sheet.faces[(sheet.triangles_center[:, 0] > 0.999)]
    vertices = sheet.vertices.copy()
    vertices[:, 0] = 0
    return _mesh(vertices, faces)


def _agrees(shape: MeshFile, exact: torch.Tensor, x: torch.Tensor, tolerance: float = 0.02) -> None:
    torch.testing.assert_close(shape(x), exact, atol=tolerance, rtol=0)


@pytest.fixture
def x(generator: torch.Generator) -> torch.Tensor:
    return 3 * torch.rand(4000, 3, generator=generator) - 1.5


def test_a_good_mesh_is_left_as_it_is() -> None:
    for mesh in (
        BALL,
        BOX,
        _joined(BALL, _at(BALL, 3, 0, 0)),
        _joined(BALL, _at(BALL, 0, 0, 0, scale=0.5, inverted=True)),
    ):
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        again = repaired(vertices, faces, "a")
        assert again[0] is vertices
        np.testing.assert_array_equal(again[1], faces)


@pytest.mark.parametrize("inverted", [False, True])
def test_repeated_triangles_count_once(
    inverted: bool, tmp_path: Path, x: torch.Tensor, caplog: pytest.LogCaptureFixture
) -> None:
    again = BALL.faces[:, ::-1] if inverted else BALL.faces
    shape = _shape(_mesh(BALL.vertices, np.concatenate([BALL.faces, again])), tmp_path)
    assert f"{len(BALL.faces)} of {2 * len(BALL.faces)} triangles of" in caplog.text
    assert "repeat others and are left out" in caplog.text
    assert shape.volume() == pytest.approx(BALL.volume)
    _agrees(shape, Ball(1.0)(x), x)


def test_triangles_that_contradict_their_neighbors_are_turned(
    tmp_path: Path, x: torch.Tensor, caplog: pytest.LogCaptureFixture
) -> None:
    faces = np.array(BALL.faces)
    some = np.random.default_rng(0).random(len(faces)) < 0.3
    faces[some] = faces[some][:, ::-1]
    shape = _shape(_mesh(BALL.vertices, faces), tmp_path)
    assert f"{some.sum()} of {len(faces)} triangles of" in caplog.text
    assert shape.volume() == pytest.approx(BALL.volume)
    _agrees(shape, Ball(1.0)(x), x)


def test_a_shell_inside_out_beside_others_is_turned(
    tmp_path: Path, x: torch.Tensor, caplog: pytest.LogCaptureFixture
) -> None:
    pieces = [_at(BALL, 0.75, 0, 0, scale=0.5), _at(BALL, -0.75, 0, 0, scale=0.5, inverted=True)]
    shape = _shape(_joined(*pieces), tmp_path)
    assert "1 of 2 shells of" in caplog.text
    _agrees(shape, torch.minimum(*(Ball(0.5, [c, 0, 0])(x) for c in (0.75, -0.75))), x)


def test_a_cavity_stays_a_cavity_also_inside_out(tmp_path: Path, x: torch.Tensor) -> None:
    hollow = _joined(BALL, _at(BALL, 0, 0, 0, scale=0.5, inverted=True))
    turned = hollow.copy()
    turned.invert()
    for mesh in (hollow, turned):
        _agrees(_shape(mesh, tmp_path), torch.maximum(Ball(1.0)(x), -Ball(0.5)(x)), x)


def test_a_wall_inside_is_left_out(tmp_path: Path, x: torch.Tensor, caplog: pytest.LogCaptureFixture) -> None:
    shape = _shape(_joined(BOX, _wall()), tmp_path)
    assert "are walls inside of it or sheets outside, and are left out" in caplog.text
    assert shape.volume() == pytest.approx(8)
    _agrees(shape, Box([2, 2, 2])(x), x, 1e-5)


def test_boxes_that_share_a_face_are_one_solid(tmp_path: Path, x: torch.Tensor) -> None:
    half = trimesh.creation.box((1, 2, 2))
    shape = _shape(_joined(_at(half, 0.5, 0, 0), _at(half, -0.5, 0, 0)), tmp_path)
    assert shape.volume() == pytest.approx(8)
    _agrees(shape, Box([2, 2, 2])(x), x, 1e-5)


def test_a_sheet_outside_is_left_out(tmp_path: Path, x: torch.Tensor) -> None:
    cape = _mesh(np.array([[1.05, -1, -1], [1.05, 1, -1], [1.05, 0, 1.0]]), np.array([[0, 1, 2]]))
    shape = _shape(_joined(BALL, cape), tmp_path)
    assert float(shape.exact_bounds()[1, 0]) == pytest.approx(1)
    _agrees(shape, Ball(1.0)(x), x)


def test_a_surface_that_cuts_itself_bounds_what_it_surrounds(tmp_path: Path, x: torch.Tensor) -> None:
    # one closed surface: a tube whose axis crosses itself as a figure of eight does
    s, phi = np.meshgrid(np.linspace(0, 2 * np.pi, 121)[:-1], np.linspace(0, 2 * np.pi, 25)[:-1], indexing="ij")
    axis = np.stack([np.sin(s), 0.6 * np.sin(2 * s), 0 * s], -1)
    along = np.stack([np.cos(s), 1.2 * np.cos(2 * s), 0 * s], -1)
    aside = np.cross(along / np.linalg.norm(along, axis=-1, keepdims=True), [0, 0, 1])
    vertices = axis + 0.2 * (np.cos(phi)[..., None] * aside + np.sin(phi)[..., None] * np.array([0, 0, 1]))
    index = np.arange(120 * 24).reshape(120, 24)
    right, up = np.roll(index, -1, 0), np.roll(index, -1, 1)
    faces = np.stack([index, right, np.roll(right, -1, 1), index, np.roll(right, -1, 1), up], -1).reshape(-1, 3)
    shape = _shape(_mesh(vertices.reshape(-1, 3), faces), tmp_path)
    dense = np.linspace(0, 2 * np.pi, 4001)
    curve = torch.from_numpy(np.stack([np.sin(dense), 0.6 * np.sin(2 * dense), 0 * dense], 1)).float()
    exact = torch.cdist(x, curve).amin(1) - 0.2
    away = exact.abs() > 0.02
    assert ((shape(x) < 0) == (exact < 0))[away].all()
    outside = exact > 0.02
    torch.testing.assert_close(shape(x)[outside], exact[outside], atol=0.02, rtol=0)


def test_a_thousand_shells_are_read_in_seconds(tmp_path: Path, generator: torch.Generator) -> None:
    places = np.stack(np.meshgrid(*[np.arange(10.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    drop = trimesh.creation.icosphere(1)
    shells = [_at(drop, *place, scale=0.4, inverted=number % 7 == 3) for number, place in enumerate(places)]
    started = time.process_time()
    shape = _shape(_joined(*shells), tmp_path)
    assert time.process_time() - started < 30
    assert shape.volume() == pytest.approx(1000 * 0.4**3 * drop.volume)
    assert (shape(torch.from_numpy(places)) < -0.3).all()
    assert (shape(torch.from_numpy(places) + 0.5) > 0.2).all()


@pytest.mark.parametrize(
    ("mesh", "words"),
    [
        (_wall(), "must be nearly closed"),
        (_joined(_wall(), _at(_wall(), 0.3, 0, 0)), "must be nearly closed"),
        (_mesh(BALL.vertices, BALL.faces[BALL.triangles_center[:, 2] > 0.9]), "must be nearly closed"),
    ],
)
def test_sheets_have_no_inside(mesh: trimesh.Trimesh, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words) as error:
        _shape(mesh, tmp_path)
    assert "\n" not in str(error.value)


def test_real_meshes_of_several_patches_keep_their_size(data_dir: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        volumes = {name: MeshFile(f"meshes/{name}.obj", fit=None).volume() for name in ("suzanne", "teapot")}
    assert all(math.isfinite(volume) and volume > 0 for volume in volumes.values())
    assert "contradict their neighbors" not in caplog.text
