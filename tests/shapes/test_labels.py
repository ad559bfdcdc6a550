"""Shapes from volumes of labels: exact volumes, the coordinates of the scanner, and files that are no labels."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from skimage.measure import marching_cubes

from nsm.cli.errors import InputError
from nsm.geometry.triangles import Triangles
from nsm.shapes import Ball, MeshFile, Similarity
from nsm.shapes.label_surface import label_surface
from nsm.shapes.labels import LabelVolume
from nsm.shapes.mesh_reading import openness, signed_volume

nibabel = pytest.importorskip("nibabel")
nrrd = pytest.importorskip("nrrd")
tifffile = pytest.importorskip("tifffile")

#: Radius in millimeters.
RADIUS = 30.0


def _ball(spacing: tuple[float, float, float], center: tuple[float, float, float]) -> np.ndarray:
    """Label 3 where the center of a voxel is in a ball, and label 5 in a box beside it."""
    count = [math.ceil((2 * RADIUS + 25) / length) for length in spacing]
    axes = [length * np.arange(n) for n, length in zip(count, spacing, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    labels = np.where(np.linalg.norm(grid - center, axis=-1) < RADIUS, 3, 0).astype(np.int16)
    labels[-4:-2, 2:5, 2:5] = 5
    return labels


def _to_file(shape: LabelVolume, x: torch.Tensor) -> torch.Tensor:
    return Similarity.read(shape.provenance()["similarity"], 3).inverse().apply(x.double())


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.8, 1.1, 2.0)])
@pytest.mark.parametrize("ending", ["nii", "nii.gz", "nrrd", "tif"])
def test_a_ball_of_voxels_has_the_volume_of_the_ball_in_millimeters(
    ending: str, spacing: tuple[float, float, float], tmp_path: Path, generator: torch.Generator
) -> None:
    labels, path = _ball(spacing, (37.3, 36.9, 38.2)), tmp_path / f"a.{ending}"
    affine = np.eye(4)
    center = torch.tensor([37.3, 36.9, 38.2], dtype=torch.float64)
    if ending.startswith("nii"):  # turned and moved, and mirrored as most scans are
        affine[:3, :3] = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix() @ np.diag([-1, 1, 1]) @ np.diag(spacing)
        affine[:3, 3] = [120, -80, 45]
        nibabel.save(nibabel.Nifti1Image(labels, affine), path)
        center = torch.from_numpy(affine[:3, :3] @ (center.numpy() / spacing) + affine[:3, 3])
    elif ending == "nrrd":
        nrrd.write(str(path), labels, {"space directions": np.diag(spacing), "space origin": [-7.0, 3.0, 2.0]})
        center += torch.tensor([-7.0, 3.0, 2.0])
    else:
        metadata = {"spacing": spacing[2], "unit": "mm", "axes": "ZYX"}
        per_mm = (1 / spacing[0], 1 / spacing[1])
        tifffile.imwrite(path, labels.T.astype(np.uint8), imagej=True, resolution=per_mm, metadata=metadata)
    shape = LabelVolume(str(path), label=3)
    scale = shape.similarity.scale
    assert shape.volume() / scale**3 == pytest.approx(4 / 3 * math.pi * RADIUS**3, rel=1e-3)
    places = _to_file(shape, shape.surface_samples(5000, generator).points) - center
    assert (places.norm(dim=1) - RADIUS).abs().max() < 0.6 * max(spacing)
    assert (places.norm(dim=1) - RADIUS).square().mean().sqrt() < 0.12 * max(spacing)
    samples = shape.distance_samples(2000, generator)
    exact = Ball(RADIUS, center.tolist())(_to_file(shape, samples.points))
    assert (samples.distances / scale - exact).abs().max() < 0.6 * max(spacing)


def test_boxes_plates_and_rods_of_voxels_keep_their_volume() -> None:
    for region, error in (
        (np.s_[3:16, 4:18, 3:13], 1e-4),
        (np.s_[3:16, 4:18, 3:4], 1e-4),  # a plate of one voxel
        (np.s_[3:16, 4:5, 3:4], 0.02),  # a rod of one voxel
    ):
        mask = np.zeros((20, 20, 20), dtype=bool)
        mask[region] = True
        surface = label_surface(mask)
        assert signed_volume(*surface) == pytest.approx(mask.sum(), rel=error)
        assert openness(*surface).edges == 0
        low, high = surface.vertices.min(0), surface.vertices.max(0)
        corners = np.argwhere(mask)
        assert np.abs(low - (corners.min(0) - 0.5)).max() < 0.25
        assert np.abs(high - (corners.max(0) + 0.5)).max() < 0.25


def test_a_mesh_and_its_voxels_are_one_shape(data_dir: Path, tmp_path: Path, generator: torch.Generator) -> None:
    mesh, cell = MeshFile("meshes/spot.obj"), 2 / 96
    axis = -1 + cell * (torch.arange(96) + 0.5)
    grid = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    inside = (mesh(grid) < 0).reshape(96, 96, 96).numpy()
    affine = np.diag([cell, cell, cell, 1.0])
    affine[:3, 3] = float(axis[0])
    nibabel.save(nibabel.Nifti1Image(inside.astype(np.uint8), affine), tmp_path / "spot.nii.gz")
    shape = LabelVolume(str(tmp_path / "spot.nii.gz"), fit=None)
    assert shape.volume() == pytest.approx(mesh.volume(), rel=2e-3)
    samples = mesh.distance_samples(4000, generator)
    error = (shape(samples.points) - samples.distances).abs().mean()
    vertices, faces, _, _ = marching_cubes(inside.astype(np.float32), 0.5)
    steps = Triangles(float(axis[0]) + cell * vertices.astype(np.float64), faces.astype(np.int64))
    plain = (steps.closest(samples.points).distances - samples.distances.abs()).abs().mean()
    assert error < 0.6 * plain
    assert error < 0.12 * cell


def test_several_labels_make_one_shape_and_the_border_closes_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    labels = np.zeros((20, 12, 12), dtype=np.uint8)
    labels[2:8, 2:10, 2:10], labels[8:, 2:10, 2:10] = 1, 2
    nibabel.save(nibabel.Nifti1Image(labels, np.eye(4)), tmp_path / "a.nii")
    shape = LabelVolume(str(tmp_path / "a.nii"), label=[1, 2], fit=None)
    assert shape.volume() == pytest.approx(18 * 64, rel=1e-3)
    assert "reaches 1 faces of the volume: it is cut and closed there" in caplog.text
    wide = LabelVolume(str(tmp_path / "a.nii"), label=[1, 2], spacing=[2, 1, 1], fit=None)
    assert wide.volume() == pytest.approx(2 * 18 * 64, rel=1e-3)


def test_what_is_no_label_meets_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(name: str, values: np.ndarray | bytes, words: str, **arguments: object) -> None:
        path = tmp_path / name
        if isinstance(values, bytes):
            path.write_bytes(values)
        else:
            nibabel.save(nibabel.Nifti1Image(values, np.eye(4)), path)
        with pytest.raises(InputError, match=words) as error:
            LabelVolume(str(path), **arguments)
        assert "\n" not in str(error.value)

    labels = _ball((2.0, 2.0, 2.0), (37, 37, 37))
    refused("a.nii", 0 * labels, "must hold a label other than 0, got none")
    refused("b.nii", labels, "`label` must be one of 3, 5 in .*b.nii, got 7. Try `label=3`", label=7)
    refused("c.nii", labels, "`label` must be one of 3, 5 in .*c.nii, got none. Try `label=3`")
    scan = np.random.default_rng(0).random(labels.shape)
    refused("d.nii", scan, "must hold whole numbers, .* different values between .* Try a segmentation")
    refused("e.nii", np.zeros((4, 4, 4, 3), dtype=np.uint8), r"three axes, got an array of shape \(4, 4, 4, 3\)")
    refused("f.nii", labels, "`spacing` must be three positive numbers", label=3, spacing=[1, 0, 1])
    refused("g.nii", b"", "got an empty file")
    refused("h.nii", b"hello", "must contain a volume in the format")
    refused("h.nrrd", b"hello", "must contain a volume in the format")
    refused("h.tif", b"hello", "must contain a volume in the format")
    refused("a.raw", b"hello", r"must end in .nii, .nii.gz, .nrrd")
    monkeypatch.setitem(sys.modules, "nibabel", None)
    with pytest.raises(InputError, match=r"Reading .nii needs `nibabel`, .* Try `pip install 'nsm\[medical\]'`"):
        LabelVolume(str(tmp_path / "a.nii"))
