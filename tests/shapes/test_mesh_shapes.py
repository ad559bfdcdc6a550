"""Shapes from meshes: distances, signs, seams, holes, orientation, fitting, and files that are no mesh."""

from __future__ import annotations

import logging
import math
import time
from pathlib import Path

import igl
import numpy as np
import pytest
import torch
import trimesh

from nsm.cli.errors import InputError
from nsm.shapes import Ball, Box, MeshFile, Similarity

SPHERE = trimesh.creation.icosphere(4, radius=2.0)
POSE = {"rotation": [20, -35, 50], "translation": [0.05, 0, -0.05], "scale": 0.9}


def _export(mesh: trimesh.Trimesh, path: Path) -> str:
    mesh.export(path)
    return str(path)


def _grid_sheet(height: float, n: int = 12) -> trimesh.Trimesh:
    axis = np.linspace(-1, 1, n)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    vertices = np.stack([x, y, height * (x**2 + y**2)], -1).reshape(-1, 3)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + n, a + 1], 1), np.stack([a + 1, a + n, a + n + 1], 1)])
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.parametrize("ending", ["obj", "ply", "stl", "off", "glb"])
def test_a_sphere_in_every_format_is_a_ball(ending: str, tmp_path: Path, generator: torch.Generator) -> None:
    shape = MeshFile(_export(SPHERE, tmp_path / f"a.{ending}"))
    samples = shape.distance_samples(4000, generator)
    torch.testing.assert_close(samples.distances, Ball(0.8)(samples.points), atol=2e-3, rtol=0)
    assert shape.volume() == pytest.approx(4 / 3 * math.pi * 0.8**3, rel=4e-3)
    surface = shape.surface_samples(4000, generator)
    assert Ball(0.8)(surface.points).abs().max() < 2e-3
    assert (surface.normals * surface.points).sum(1).min() > 0.79
    torch.testing.assert_close(shape.bounds(), torch.tensor([[-0.8] * 3, [0.8] * 3]), atol=1e-6, rtol=0)


def test_distances_are_those_of_a_brute_force_search(tmp_path: Path, generator: torch.Generator) -> None:
    shape = MeshFile(_export(trimesh.creation.box((1, 2, 3)), tmp_path / "a.obj"), pose=POSE)
    samples = shape.distance_samples(1000, generator)
    cloud = shape.surface_samples(200000, generator).points
    excess = torch.cdist(samples.points, cloud).amin(1) - samples.distances.abs()
    assert excess.min() > -1e-5
    assert excess.mean() < 2e-3


def test_flipped_meshes_are_turned(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    flipped = SPHERE.copy()
    flipped.invert()
    shape = MeshFile(_export(flipped, tmp_path / "a.ply"))
    assert "inside out" in caplog.text
    assert shape.volume() > 0
    assert shape(torch.zeros(1, 3)) < 0


def test_seams_are_welded_without_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    soup = SPHERE.copy()
    soup.unmerge_vertices()
    with caplog.at_level(logging.WARNING):
        shape = MeshFile(_export(soup, tmp_path / "a.ply"))
    assert len(shape.vertices) == len(SPHERE.vertices)
    assert shape.openness.edges == 0
    assert not caplog.text


def test_a_holed_mesh_keeps_its_inside_and_says_how_open_it_is(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, generator: torch.Generator
) -> None:
    holed = SPHERE.copy()
    holed.update_faces(~((holed.triangles_center[:, 2] > 1.9) | (holed.triangles_center[:, 0] < -1.95)))
    shape = MeshFile(_export(holed, tmp_path / "a.ply"), fit=None, pose={"scale": 0.4})
    assert shape.openness.loops == 2
    assert f"{shape.openness.edges} boundary edges in 2 loops" in caplog.text
    x = 2 * torch.rand(3000, 3, generator=generator) - 1
    ball = Ball(0.8)(x)
    agree = (shape(x) < 0) == (ball < 0)
    assert agree[ball.abs() > 0.05].all()
    assert shape.volume() == pytest.approx(4 / 3 * math.pi * 0.8**3, rel=0.03)


def test_parts_inside_others_are_left_out_and_holes_are_closed(tmp_path: Path, generator: torch.Generator) -> None:
    # a box through a ball with a hole: neither the walls inside, nor the hole, are where the distance is 0
    ball = trimesh.creation.icosphere(4)
    ball.update_faces(ball.triangles_center[:, 2] < 0.93)
    both = trimesh.util.concatenate([ball, trimesh.creation.box((2.4, 0.6, 0.6))])
    shape = MeshFile(_export(both, tmp_path / "a.ply"), fit=None)
    x = 1.3 * (2 * torch.rand(20000, 3, generator=generator) - 1)
    exact = torch.minimum(Ball(1.0)(x), Box([2.4, 0.6, 0.6])(x))
    away = exact.abs() > 0.1  # there the chord of the hole and the rounding of the ball make no difference of sign
    assert ((shape(x) < 0) == (exact < 0))[away].all()
    samples = shape.surface_samples(4000, generator).points
    depth = torch.minimum(Ball(1.0)(samples), Box([2.4, 0.6, 0.6])(samples))
    assert depth.min() > -0.09  # the depth of the hole
    assert ((samples[:, 2] > 0.9) & (samples[:, :2].norm(dim=1) < 0.2)).any()
    step = 1e-3 * torch.nn.functional.normalize(torch.randn(20000, 3, generator=generator), dim=1)
    assert (shape(x + step) - shape(x)).abs().max() < 0.02


def test_fit_and_pose_are_undone_by_the_provenance(tmp_path: Path) -> None:
    mesh = trimesh.creation.box((1, 2, 4))
    mesh.apply_translation((5, 6, 7))
    path = _export(mesh, tmp_path / "a.ply")
    plain, posed = MeshFile(path, fit=0.6), MeshFile(path, fit=0.6, pose=POSE)
    torch.testing.assert_close(plain.bounds(), torch.tensor([[-0.15, -0.3, -0.6], [0.15, 0.3, 0.6]]))
    for shape in (plain, posed):
        back = Similarity.read(shape.provenance()["similarity"], 3).inverse()
        vertices = back.apply(shape.surface().vertices.double())
        expected = torch.tensor([[4.5, 5, 5], [5.5, 7, 9]], dtype=torch.float64)
        torch.testing.assert_close(torch.stack([vertices.amin(0), vertices.amax(0)]), expected, atol=1e-5, rtol=0)


def test_coordinates_of_the_file_can_be_kept(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(2, radius=0.3)
    mesh.apply_translation((0.5, 0, 0))
    shape = MeshFile(_export(mesh, tmp_path / "a.ply"), fit=None)
    torch.testing.assert_close(shape.bounds()[1], torch.tensor([0.8, 0.3, 0.3]), atol=1e-2, rtol=0)


def test_the_key_changes_with_content_fit_and_pose_alone(tmp_path: Path) -> None:
    one, copy = _export(SPHERE, tmp_path / "a.ply"), _export(SPHERE, tmp_path / "b.ply")
    other = _export(trimesh.creation.box(), tmp_path / "c.ply")
    key = MeshFile(one).content_key()
    assert MeshFile(copy).content_key() == key
    others = [MeshFile(other), MeshFile(one, fit=0.7), MeshFile(one, pose=POSE)]
    assert len({key, *(shape.content_key() for shape in others)}) == 4


def test_files_without_a_usable_mesh_are_rejected(tmp_path: Path) -> None:
    def refused(name: str, content: bytes | trimesh.Trimesh, words: str, **arguments: object) -> None:
        path = tmp_path / name
        if isinstance(content, bytes):
            path.write_bytes(content)
        else:
            content.export(path)
        with pytest.raises(InputError, match=words) as error:
            MeshFile(str(path), **arguments)
        assert "\n" not in str(error.value)

    whole = Path(_export(SPHERE, tmp_path / "whole.ply")).read_bytes()
    text = Path(_export(SPHERE, tmp_path / "whole.obj")).read_bytes()
    refused("a.ply", b"", "got an empty file")
    refused("b.ply", whole[: len(whole) // 2], "must contain a mesh in the format of its extension.* may be truncated")
    refused("b.obj", text[: int(0.8 * len(text))], "may be truncated")
    refused("c.obj", text[: len(text) // 4], "may be truncated")
    refused("c.ply", b"hello", "must contain a mesh in the format")
    refused("d.xyz", b"1 2 3", r"must end in .obj.*, got .*d.xyz. Try")
    refused("e.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 4 3\n", "must have finite vertices")
    refused("f.obj", _grid_sheet(0.0), "must be nearly closed, got 44 boundary edges")
    refused("g.obj", _grid_sheet(0.03), "must be nearly closed")
    sheet = _grid_sheet(0.0)
    back = np.concatenate([sheet.faces, sheet.faces[:, ::-1]])
    refused("h.obj", trimesh.Trimesh(sheet.vertices, back, process=False), "must be nearly closed")
    refused("i.obj", b"v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n", "vertices that all coincide")
    refused("j.ply", SPHERE, r"`up` must be 3 numbers .* Try `up=\[0, 1, 0\]`", up=[0, 0, 0])
    refused("l.ply", SPHERE, r"`fit` must be in \(0, 1\], or null .*, got 1.5", fit=1.5)
    with pytest.raises(InputError, match="`path` must be a file, got the folder"):
        MeshFile(str(tmp_path))
    with pytest.raises(InputError, match="must be an existing file"):
        MeshFile(str(tmp_path / "nothing.obj"))


@pytest.mark.parametrize(
    ("name", "open_", "euler"),
    [("spot", False, 2), ("fandisk", False, 2), ("stanford-bunny", True, None), ("teapot", True, None)],
)
def test_real_meshes(
    name: str,
    open_: bool,
    euler: int | None,
    data_dir: Path,
    caplog: pytest.LogCaptureFixture,
    generator: torch.Generator,
) -> None:
    shape = MeshFile(f"meshes/{name}.obj")
    assert bool(shape.openness.edges) == open_ == ("is open" in caplog.text)
    if euler is not None:
        faces = shape.faces.numpy()
        assert igl.euler_characteristic(faces) == euler
    started = time.perf_counter()
    samples = shape.distance_samples(20000, generator)
    assert time.perf_counter() - started < 5
    assert samples.distances.isfinite().all()
    uniform = samples.distances[:10000]
    assert float((uniform < 0).double().mean()) * 8 == pytest.approx(shape.volume(), rel=0.1)
    surface = shape.surface_samples(5000, generator)
    outside = shape(surface.points + 1e-3 * surface.normals) > 0
    assert outside.double().mean() > (0.95 if open_ else 0.999)
