"""Shapes from point clouds: distances, signs, orientation, and files that are no oriented cloud."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from nsm.cli.errors import InputError
from nsm.shapes import Ball, MeshFile, PointCloud, Similarity


def _sphere(count: int = 6000, radius: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """Points of a Fibonacci lattice on the sphere, and their normals."""
    k = np.arange(count) + 0.5
    z, phi = 1 - 2 * k / count, math.pi * (1 + 5**0.5) * k
    normals = np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z], 1)
    return radius * normals, normals


def _write(path: Path, points: np.ndarray, normals: np.ndarray | None) -> str:
    rows = points if normals is None else np.concatenate([points, normals], 1)
    if path.suffix == ".xyz":
        np.savetxt(path, rows)
        return str(path)
    names = ("x", "y", "z", "nx", "ny", "nz")[: rows.shape[1]]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header = "\n".join([*lines, *(f"property float {n}" for n in names), "end_header", ""])
    path.write_bytes(header.encode() + rows.astype("<f4").tobytes())
    return str(path)


@pytest.mark.parametrize("ending", ["ply", "xyz"])
def test_a_sphere_of_points_is_a_ball(ending: str, tmp_path: Path, generator: torch.Generator) -> None:
    points, normals = _sphere()
    shape = PointCloud(_write(tmp_path / f"a.{ending}", points, 3 * normals))
    samples = shape.distance_samples(20000, generator)
    exact = Ball(0.8)(samples.points)
    assert (samples.distances - exact).abs().max() < 4e-3
    assert ((samples.distances < 0) == (exact < 0))[exact.abs() > 1e-3].all()
    near = exact.abs() < 0.02
    assert (samples.distances - exact)[near].abs().mean() < 4e-4
    assert shape.volume() == pytest.approx(4 / 3 * math.pi * 0.8**3, rel=2e-3)


def test_the_tangent_planes_make_distances_better_than_those_to_the_points(
    tmp_path: Path, generator: torch.Generator
) -> None:
    points, normals = _sphere(1500)
    shape = PointCloud(_write(tmp_path / "a.ply", points, normals))
    samples = shape.distance_samples(5000, generator)
    exact = Ball(0.8)(samples.points)
    plain = torch.cdist(samples.points, torch.from_numpy(0.4 * points).float()).amin(1)
    near = exact.abs() < 0.05
    error = (samples.distances - exact).abs()[near].mean()
    assert error < 0.2 * (plain - exact.abs()).abs()[near].mean()


def test_samples_are_points_of_the_cloud_with_unit_normals(tmp_path: Path, generator: torch.Generator) -> None:
    points, normals = _sphere(500)
    shape = PointCloud(_write(tmp_path / "a.ply", points, 5 * normals))
    some, more = shape.surface_samples(400, generator), shape.surface_samples(1200, generator)
    assert len(some.points.unique(dim=0)) == 400
    assert len(more.points.unique(dim=0)) == 500
    torch.testing.assert_close(more.normals, more.points / 0.8, atol=5e-3, rtol=0)


def test_the_pose_turns_the_normals_and_the_provenance_undoes_it(tmp_path: Path, generator: torch.Generator) -> None:
    points, normals = _sphere()
    points = points * np.array([1, 0.6, 0.4])
    normals = normals / np.array([1, 0.6, 0.4])
    pose = {"rotation": [20, -35, 50], "translation": [0.05, 0, -0.05], "scale": 0.9}
    path = _write(tmp_path / "a.ply", points, normals)
    plain, posed = PointCloud(path), PointCloud(path, pose=pose)
    move = Similarity.read(pose, 3)
    x = 2 * torch.rand(2000, 3, generator=generator) - 1
    torch.testing.assert_close(posed.signed_distance(move.apply(x)), 0.9 * plain.signed_distance(x), atol=1e-5, rtol=0)
    back = Similarity.read(posed.provenance()["similarity"], 3).inverse()
    assert back.apply(posed.bounds().double()).shape == (2, 3)
    own = back.apply(posed.surface_samples(len(points), generator).points.double())
    torch.testing.assert_close(own.amax(0), torch.from_numpy(points).amax(0), atol=1e-5, rtol=0)


def test_inward_normals_are_flipped(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    points, normals = _sphere()
    shape = PointCloud(_write(tmp_path / "a.ply", points, -normals))
    assert "point inward; they are flipped" in caplog.text
    assert shape.signed_distance(torch.zeros(1, 3)) < 0


def test_files_without_an_oriented_cloud_are_rejected(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    points, normals = _sphere(2000)

    def refused(path: str, words: str, **arguments: object) -> None:
        with pytest.raises(InputError, match=words) as error:
            PointCloud(path, **arguments)
        assert "\n" not in str(error.value)

    whole = _write(tmp_path / "whole.ply", points, normals)
    (tmp_path / "cut.ply").write_bytes(Path(whole).read_bytes()[:20000])
    (tmp_path / "empty.ply").write_bytes(b"")
    (tmp_path / "a.obj").write_bytes(b"v 0 0 0\n")
    holes = points.copy()
    holes[3, 1] = np.nan
    random = np.random.default_rng(0).normal(size=normals.shape)
    flat = points * np.array([1, 1, 0])
    refused(str(tmp_path / "cut.ply"), "may be truncated")
    refused(str(tmp_path / "empty.ply"), "got an empty file")
    refused(str(tmp_path / "a.obj"), r"must end in .ply, .xyz, .* got '.obj'")
    refused(str(tmp_path), "must be a file, got the folder")
    refused(_write(tmp_path / "c.xyz", points[:, :2], None), r"three numbers .* got an array of shape \(2000, 2\)")
    refused(_write(tmp_path / "d.ply", holes, normals), "must have finite points and normals, got 1")
    refused(_write(tmp_path / "e.ply", points, 0 * normals), "at least 48 distinct points with normals, got 0")
    nothing = "must have normals that enclose a volume"
    refused(_write(tmp_path / "f.ply", points, random), nothing)
    refused(_write(tmp_path / "g.ply", flat, np.tile([0.0, 0, 1], (2000, 1))), nothing)
    PointCloud(_write(tmp_path / "h.ply", points, np.where(np.arange(2000)[:, None] % 5 == 0, -normals, normals)))
    assert "contradict the others" in caplog.text


def test_a_published_cloud_agrees_with_its_mesh(data_dir: Path, generator: torch.Generator) -> None:
    cloud = PointCloud("official/meshes/bust.ply", fit=None)
    mesh = MeshFile("official/meshes/bust.ply", fit=None)
    samples = cloud.distance_samples(20000, generator)
    exact = mesh(samples.points)
    assert (samples.distances - exact).abs().mean() < 1e-3
    assert ((samples.distances < 0) == (exact < 0)).double().mean() > 0.99
