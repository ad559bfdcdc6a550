"""Point clouds without normals: estimated and oriented normals, partial clouds, and every format that holds points."""

from __future__ import annotations

import logging
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from nsm.cli.errors import InputError
from nsm.shapes import Ball, MeshFile, PointCloud
from nsm.shapes.orientation import estimate_normals, find_rims


def _on(mesh: trimesh.Trimesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points drawn on a mesh, and the normals there."""
    points, faces = trimesh.sample.sample_surface(mesh, count, seed=0)
    return np.asarray(points), mesh.face_normals[faces]


def _sphere(count: int = 6000, above: float = -2.0) -> np.ndarray:
    """Points of a Fibonacci lattice on the unit sphere, those with z below ``above`` left out."""
    k = np.arange(count) + 0.5
    z, phi = 1 - 2 * k / count, math.pi * (1 + 5**0.5) * k
    points = np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z], 1)
    return points[z > above]


def test_normals_of_a_sphere_are_its_points() -> None:
    points = np.random.default_rng(0).permutation(_sphere())
    found = estimate_normals(points)
    assert (found.normals * points).sum(1).min() > 0.999
    assert found.agreement == 1
    assert found.pieces == 1


def test_every_piece_of_a_cloud_is_turned_outwards() -> None:
    points = _sphere(1000)
    found = estimate_normals(np.concatenate([points, points + np.array([5, 0, -1])]))
    assert found.pieces == 2
    assert (found.normals * np.concatenate([points, points])).sum(1).min() > 0.99


@pytest.mark.parametrize(("name", "right"), [("spot", 0.999), ("fandisk", 0.999), ("rocker-arm", 0.999)])
def test_normals_of_real_shapes(name: str, right: float, data_dir: Path) -> None:
    points, normals = _on(trimesh.load(data_dir / "meshes" / f"{name}.obj", force="mesh"), 10000)
    found = estimate_normals(points)
    cosines = (found.normals * normals).sum(1)
    assert (cosines > 0).mean() > right
    assert np.median(cosines) > 0.995


def test_a_cloud_without_normals_is_the_shape_and_says_how_sure_that_is(
    data_dir: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture, generator: torch.Generator
) -> None:
    path = tmp_path / "spot.xyz"
    points, _ = _on(trimesh.load(data_dir / "meshes/spot.obj", force="mesh"), 20000)
    np.savetxt(path, points)
    with caplog.at_level(logging.INFO):
        cloud = PointCloud(str(path), fit=None)
    assert "has no normals: they are estimated from 12 neighbors each" in caplog.text
    assert "% of the neighbors agree, and the winding number confirms the side of" in caplog.text
    assert cloud.provenance()["normals"] == "estimated"
    mesh = MeshFile("meshes/spot.obj", fit=None)
    samples = cloud.distance_samples(10000, generator)
    exact = mesh(samples.points)
    assert (samples.distances - exact).abs().mean() < 2e-3
    assert ((samples.distances < 0) == (exact < 0)).double().mean() > 0.99
    assert cloud.volume() == pytest.approx(mesh.volume(), rel=0.02)


def test_rims_are_counted_and_closed_clouds_have_none(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    whole, cut = _sphere(), _sphere(above=-0.8)
    assert find_rims(whole, whole).holes == 0
    ring = find_rims(cut, cut)
    assert ring.holes == 1
    along = 2 * math.pi * 0.6 / math.sqrt(4 * math.pi / 6000)  # points of the lattice along the rim
    assert 0.5 * along < ring.points < 1.5 * along
    np.save(tmp_path / "cut.npy", cut)
    shape = PointCloud(str(tmp_path / "cut.npy"), fit=None)
    assert f"partial cloud: {ring.points} of its {len(cut)} points lie at the rims of about 1 holes" in caplog.text
    x = torch.tensor([[0, 0, 0], [0, 0, -0.6], [0, 0, 0.9], [0, 0, -1.2], [1.1, 0, 0]], dtype=torch.float64)
    assert (shape.signed_distance(x) < 0).tolist() == [True, True, True, False, False]
    cap = math.pi * 0.2**2 * (3 - 0.2) / 3
    assert 4 / 3 * math.pi - 1.5 * cap < shape.volume() < 4 / 3 * math.pi


@pytest.mark.parametrize("ending", ["ply", "xyz", "txt", "npy", "las", "laz"])
def test_every_format_of_points_gives_the_same_shape(
    ending: str, tmp_path: Path, generator: torch.Generator, request: pytest.FixtureRequest
) -> None:
    points, path = _sphere(), tmp_path / f"a.{ending}"
    if ending == "ply":
        trimesh.PointCloud(points).export(path)
    elif ending == "npy":
        np.save(path, points)
    elif ending in ("las", "laz"):
        laspy = pytest.importorskip("laspy")
        header = laspy.LasHeader(point_format=0, version="1.2")
        header.scales, header.offsets = [1e-5] * 3, [0.0] * 3
        content = laspy.LasData(header)
        content.x, content.y, content.z = points.T
        content.write(str(path))
    else:
        np.savetxt(path, points, delimiter="," if ending == "txt" else " ")
    shape = PointCloud(str(path))
    samples = shape.distance_samples(5000, generator)
    assert (samples.distances - Ball(0.8)(samples.points)).abs().max() < 4e-3


def test_columns_of_colors_are_no_normals(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    points = _sphere()
    np.savetxt(tmp_path / "a.xyz", np.concatenate([points, np.full_like(points, 200)], 1))
    shape = PointCloud(str(tmp_path / "a.xyz"))
    assert "taken for colors" in caplog.text
    assert shape.provenance()["normals"] == "estimated"


def test_what_is_no_cloud_meets_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = _sphere(500)
    points[7] = np.nan
    np.save(tmp_path / "nan.npy", points)
    np.save(tmp_path / "flat.npy", points[:, :2])
    np.save(tmp_path / "few.npy", _sphere(30))
    np.save(tmp_path / "sheet.npy", np.random.default_rng(0).random((2000, 3)) * [1, 1, 0])
    (tmp_path / "words.xyz").write_text("one two three\n")
    (tmp_path / "a.las").write_bytes(b"LASF")
    for name, words in {
        "nan.npy": "must have finite points and normals, got 1 not finite",
        "flat.npy": r"rows of three numbers \(x y z\) or six .* got an array of shape \(500, 2\)",
        "few.npy": "must have at least 48 distinct points, got 30",
        "sheet.npy": "must have normals that enclose a volume",
        "words.xyz": "must contain points in the format",
    }.items():
        with pytest.raises(InputError, match=words) as error:
            PointCloud(str(tmp_path / name))
        assert "\n" not in str(error.value)
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(InputError, match=r"Reading .las needs `laspy`, .* Try `pip install 'nsm\[lidar\]'`"):
        PointCloud(str(tmp_path / "a.las"))
