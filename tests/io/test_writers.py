"""Files that are written can be read back, and are whole or not there."""

from __future__ import annotations

import csv
import os

import pytest
import torch
import trimesh
from PIL import Image
from problems import MOTIONS

from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.geometry.meshing import extract_surface
from nsm.io.mesh import write_mesh
from nsm.plots.curves import plot_volume_curves, write_volume_curve
from nsm.types import SimplexMesh


def picture_size(path):
    with Image.open(path) as picture:
        return picture.size


@pytest.fixture(scope="module")
def sphere():
    motion = MOTIONS["translating_ball"](3)
    return extract_surface(motion.source, motion.bounds, 16)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
def test_a_surface_is_read_back(tmp_path, sphere, suffix):
    path = tmp_path / "deep" / f"sphere{suffix}"
    normals = torch.nn.functional.normalize(sphere.vertices - torch.tensor([-0.3, -0.15, 0.1]), dim=1)
    write_mesh(path, sphere, normals)
    back = trimesh.load(path, process=False)
    corners = sphere.vertices[sphere.simplices].numpy()
    assert back.vertices[back.faces] == pytest.approx(corners, abs=1e-6)
    if suffix != ".stl":
        assert back.vertex_normals == pytest.approx(normals.numpy(), abs=1e-5)
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_a_curve_is_read_back(tmp_path):
    motion = MOTIONS["rotating_box"](2)
    mesh = extract_surface(motion.source, motion.bounds, 16)
    write_mesh(tmp_path / "curve.obj", mesh)
    lines = [line.split() for line in (tmp_path / "curve.obj").read_text().splitlines()]
    vertices = torch.tensor([[float(word) for word in line[1:]] for line in lines if line[0] == "v"])
    segments = torch.tensor([[int(word) for word in line[1:]] for line in lines if line[0] == "l"])
    assert vertices[:, :2] == pytest.approx(mesh.vertices.float())
    assert torch.equal(segments - 1, mesh.simplices)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
def test_a_surface_that_is_not_there_is_a_file_too(tmp_path, suffix):
    write_mesh(tmp_path / f"empty{suffix}", SimplexMesh(torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.long)))
    assert [p.name for p in tmp_path.iterdir()] == [f"empty{suffix}"]
    if suffix == ".ply":
        assert b"element face 0" in (tmp_path / "empty.ply").read_bytes()


def test_unknown_formats_are_named(tmp_path, sphere):
    with pytest.raises(InputError, match=r"must end in \.ply or \.obj or \.stl, got sphere\.xyz"):
        write_mesh(tmp_path / "sphere.xyz", sphere)
    with pytest.raises(InputError, match=r"in 2D must end in \.obj, got curve\.ply"):
        write_mesh(tmp_path / "curve.ply", SimplexMesh(torch.zeros(2, 2), torch.tensor([[0, 1]])))
    assert not list(tmp_path.iterdir())


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("old")
    with pytest.raises(OSError, match="No such"), atomic_write(path) as temporary:
        temporary.rename(tmp_path / "no such" / "folder")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_new_file_has_the_usual_permissions(tmp_path):
    mask = os.umask(0o022)
    try:
        with atomic_write(tmp_path / "file.txt") as temporary:
            temporary.write_text("whole")
    finally:
        os.umask(mask)
    assert (tmp_path / "file.txt").stat().st_mode & 0o777 == 0o644


def test_places_that_cannot_be_written_are_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="must be writable"), atomic_write(tmp_path / "file" / "mesh.ply"):
        pass
    with pytest.raises(InputError, match="got a folder"), atomic_write(tmp_path):
        pass


def test_volume_curves(tmp_path):
    times, volumes = torch.tensor([0.0, 0.5, 1.0]), torch.tensor([0.5, 0.51, 0.495])
    write_volume_curve(tmp_path / "curve.csv", times, volumes)
    with (tmp_path / "curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["deviation"]) for row in rows] == pytest.approx([0, 0.02, -0.01], abs=1e-6)
    assert [float(row["volume"]) for row in rows] == pytest.approx(volumes.tolist())
    plot_volume_curves(tmp_path / "curve.png", {"one": (times, volumes), "gone": (times, torch.zeros(3))})
    assert picture_size(tmp_path / "curve.png")[0] > 500
