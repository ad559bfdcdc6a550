"""Alignment: known rotations, scales, and shifts are found, whatever the initial position."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from kornia.geometry.conversions import quaternion_to_rotation_matrix
from nightly import tries
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.shapes import (
    Ball,
    Box,
    Cylinder,
    MeshFile,
    MeshShape,
    Polygon,
    RigidAlignment,
    SharedCoordinates,
    Similarity,
    SimilarityAlignment,
    Unaligned,
)
from nsm.shapes.rotations import COVERING, covering_rotations, rotation_angles, rotation_generators

#: Meshes without symmetry, on each of which this many random rotations are tried, 20 at night.
ASYMMETRIC = ("fandisk", "rocker-arm", "spot", "suzanne", "teapot")
ROTATIONS = tries(4, 20)


def random_rotations(count: int, seed: int = 0) -> Tensor:
    quaternions = torch.randn(count, 4, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return quaternion_to_rotation_matrix(torch.nn.functional.normalize(quaternions, dim=1))


def moved_file(shape: MeshShape, move: Similarity) -> MeshShape:
    """The mesh as another file would give it, in whose coordinates it is turned, scaled, and shifted."""
    linear = Similarity(move.rotation, torch.zeros(3, dtype=torch.float64), move.scale)
    shift = move.apply(shape.similarity.pull_back(shape.placement.translation[None]))
    vertices = linear.apply(shape.vertices)
    fitting = Similarity.centering(torch.stack([vertices.amin(0), vertices.amax(0)]), 0.8)
    pose = fitting.after(Similarity.shift(-shift[0]))
    moved = MeshShape(len(vertices), len(shape.faces), shape.closed, pose, fitting, {**shape.origin, "path": "moved"})
    moved.vertices.copy_(vertices)
    moved.faces.copy_(shape.faces)
    return moved


def angle(rotation: Tensor, wanted: Tensor) -> float:
    """Angle between two rotations in degrees."""
    return float(rotation_angles((rotation.T @ wanted)[None])[0])


def transformation(provenance: dict) -> Similarity:
    """From the coordinates of the target's file to those of the source's file."""
    return Similarity.read(provenance["transformation"], len(provenance["transformation"]["translation"]))


@pytest.fixture(scope="module", params=ASYMMETRIC)
def mesh(request: pytest.FixtureRequest, data_dir: Path) -> Iterator[MeshShape]:
    return MeshFile(str(data_dir / "meshes" / f"{request.param}.obj"))


def test_random_rotations_are_undone_within_a_degree(mesh: MeshShape) -> None:
    for number, rotation in enumerate(random_rotations(ROTATIONS)):
        move = Similarity(rotation, torch.tensor([100.0, -20.0, 3.0], dtype=torch.float64))
        target, provenance = RigidAlignment()(mesh, moved_file(mesh, move))
        undone = transformation(provenance).after(move)
        assert rotation_angles(undone.rotation[None])[0] < 1, number
        assert undone.rotation.det() == pytest.approx(1)
        assert undone.scale == pytest.approx(1, abs=1e-12)
        assert provenance["residual"] < 1e-3
        x = torch.rand(50, 3) - 0.5
        torch.testing.assert_close(target(x), mesh(x), atol=1e-2, rtol=0)


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_a_similarity_finds_the_scale_too(scale: float, data_dir: Path) -> None:
    spot = MeshFile(str(data_dir / "meshes" / "spot.obj"))
    move = Similarity(random_rotations(1, seed=3)[0], torch.tensor([5.0, 0, -70], dtype=torch.float64), scale)
    target, provenance = SimilarityAlignment()(spot, moved_file(spot, move))
    undone = transformation(provenance).after(move)
    assert undone.scale == pytest.approx(1, abs=1e-5)
    assert rotation_angles(undone.rotation[None])[0] < 0.01
    assert target.volume() == pytest.approx(spot.volume(), rel=1e-4)


@pytest.mark.parametrize("name", ["spot", "suzanne"])
def test_half_of_a_mesh_finds_its_place_on_the_whole(name: str, data_dir: Path, tmp_path: Path) -> None:
    file = data_dir / "meshes" / f"{name}.obj"
    half = trimesh.load(file, force="mesh", process=False)
    move = Similarity(random_rotations(1, seed=4)[0], torch.zeros(3, dtype=torch.float64))
    height = half.triangles_center[:, 1]
    half.update_faces(height > np.median(height))
    half.vertices = move.apply(torch.from_numpy(half.vertices)).numpy()
    half.export(tmp_path / "half.ply")
    _, provenance = RigidAlignment()(MeshFile(str(file)), MeshFile(str(tmp_path / "half.ply")))
    assert rotation_angles(transformation(provenance).after(move).rotation[None])[0] < 3


@pytest.mark.parametrize("dim", [2, 3])
def test_a_shifted_ball_is_found_exactly(dim: int) -> None:
    source, target = Ball(0.4, [0.0] * dim), Ball(0.4, [0.3, -0.2, 0.1][:dim])
    aligned, provenance = RigidAlignment()(source, target)
    found = transformation(provenance)
    assert torch.equal(found.rotation, torch.eye(dim, dtype=torch.float64))
    torch.testing.assert_close(found.translation, torch.tensor([-0.3, 0.2, -0.1][:dim]).double(), atol=1e-6, rtol=0)
    assert provenance["residual"] < 1e-6
    x = torch.rand(100, dim) - 0.5
    torch.testing.assert_close(aligned(x), source(x), atol=1e-6, rtol=0)


def test_a_symmetric_shape_fits_exactly_and_ambiguously(caplog: pytest.LogCaptureFixture) -> None:
    source = Cylinder(0.2, 0.9)
    turned = Cylinder(0.2, 0.9, pose={"rotation": [0, 25, 0], "translation": [0.2, 0.1, 0]})
    with caplog.at_level(logging.INFO):
        target, provenance = RigidAlignment()(source, turned)
    assert provenance["ambiguous"]
    assert provenance["residual"] < 1e-5
    assert "the alignment is ambiguous: turned by a further" in caplog.text
    assert float(re.search(r"turned by ([\d.]+) degrees; mean distance", caplog.text)[1]) < 35  # it takes 25
    x = torch.rand(100, 3) - 0.5
    torch.testing.assert_close(target(x), source(x), atol=1e-4, rtol=0)


def test_a_shape_without_symmetry_is_not_called_ambiguous(data_dir: Path, caplog: pytest.LogCaptureFixture) -> None:
    spot = MeshFile(str(data_dir / "meshes" / "spot.obj"))
    _, provenance = RigidAlignment()(spot, moved_file(spot, Similarity.identity(3)))
    assert not provenance["ambiguous"]
    assert "ambiguous" not in caplog.text


def test_a_mirror_image_is_turned_and_not_reflected(data_dir: Path) -> None:
    rocker = MeshFile(str(data_dir / "meshes" / "rocker-arm.obj"))
    mirrored = moved_file(rocker, Similarity.identity(3))
    mirrored.vertices[:, 0] *= -1
    mirrored.faces.copy_(mirrored.faces.flip(1))
    _, provenance = RigidAlignment()(rocker, mirrored)
    assert transformation(provenance).rotation.det() == pytest.approx(1)
    assert provenance["residual"] > 1e-3


@pytest.mark.parametrize("degrees", [35.0, 170.0, -100.0])
def test_a_polygon_is_turned_back_in_the_plane(degrees: float) -> None:
    corners = [[0.0, 0.0], [0.9, 0.0], [0.9, 0.3], [0.3, 0.3], [0.3, 0.6], [0.0, 0.6]]
    move = Similarity.read({"rotation": degrees, "translation": [0.2, -0.1]}, 2)
    other = move.apply(torch.tensor(corners, dtype=torch.float64)).tolist()
    _, provenance = RigidAlignment()(Polygon(corners), Polygon(other))
    undone = transformation(provenance).after(move)
    torch.testing.assert_close(undone.rotation, torch.eye(2).double(), atol=1e-3, rtol=0)
    torch.testing.assert_close(undone.translation, torch.zeros(2).double(), atol=1e-3, rtol=0)


def test_files_of_one_coordinate_system_keep_it(tmp_path: Path) -> None:
    shapes = []
    for name, size, x in (("a", (1, 2, 3), 900.0), ("b", (2, 2, 2), 901.5)):
        mesh = trimesh.creation.box(size)
        mesh.apply_translation([x, 0, 0])
        mesh.export(tmp_path / f"{name}.obj")
        shapes.append(MeshFile(str(tmp_path / f"{name}.obj"), pose={"rotation": [0, 40, 0]}))
    source, (target, _) = shapes[0], SharedCoordinates()(*shapes)
    torch.testing.assert_close(target.similarity.rotation, source.similarity.rotation)
    assert target.similarity.scale == pytest.approx(source.similarity.scale)
    back = source.similarity.inverse()
    for shape, center, volume in ((source, 900.0, 6.0), (target, 901.5, 8.0)):
        middle = back.apply(shape.placement.translation[None])[0]
        torch.testing.assert_close(middle, torch.tensor([center, 0, 0]).double(), atol=1e-6, rtol=0)
        assert shape.volume() * back.scale**3 == pytest.approx(volume, rel=1e-9)


def test_files_far_from_each_other_do_not_share_coordinates(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name, x in (("a", 0.0), ("b", 5.0)):
        mesh = trimesh.creation.box((1, 1, 1))
        mesh.apply_translation([x, 0, 0])
        mesh.export(tmp_path / f"{name}.obj")
    SharedCoordinates()(*(MeshFile(str(tmp_path / f"{name}.obj")) for name in "ab"))
    assert "lie apart in the coordinates that they share, by 4 times the size of the source" in caplog.text


def test_coordinates_are_shared_by_two_files_of_one_orientation(tmp_path: Path) -> None:
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "a.obj")
    upright, lying = (MeshFile(str(tmp_path / "a.obj"), up=up) for up in ([0, 1, 0], [0, 0, 1]))
    with pytest.raises(InputError, match=r"got orientations that differ by 90 degrees\. Try `align=rigid`"):
        SharedCoordinates()(upright, lying)
    with pytest.raises(InputError, match=r"`target` must be a file with align=shared, got a ball\. Try `align=none`"):
        SharedCoordinates()(upright, Ball(0.4))


def test_other_units_are_noticed(caplog: pytest.LogCaptureFixture) -> None:
    RigidAlignment()(Box([1.0, 0.6, 0.4]), Box([0.1, 0.06, 0.04]))
    assert "the source is 10 times as large as the target" in caplog.text


def test_no_alignment_changes_nothing() -> None:
    target = Ball(0.3, [0.1, 0, 0])
    assert Unaligned()(Ball(0.4), target).target is target


@pytest.mark.parametrize(("dim", "reach"), [(2, 5.001), (3, 33)])
def test_the_initial_rotations_cover_all(dim: int, reach: float) -> None:
    starts = covering_rotations(dim)
    assert len(starts) == COVERING[dim]
    eye = torch.eye(dim, dtype=torch.float64)
    torch.testing.assert_close(starts @ starts.mT, eye.expand(len(starts), dim, dim))
    wanted = random_rotations(300) if dim == 3 else Similarity.read({"rotation": 37.0}, 2).rotation[None]
    assert max(float(rotation_angles(starts.mT @ each).min()) for each in wanted) < reach


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("degrees", [1e-6, 10.0, 179.0])
def test_the_exponential_of_a_generator_turns_by_its_angle(dim: int, degrees: float) -> None:
    turned = torch.matrix_exp(math.radians(degrees) * rotation_generators(dim))
    torch.testing.assert_close(rotation_angles(turned), torch.full((len(turned),), degrees).double())
