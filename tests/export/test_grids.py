"""Fields on a grid and carried labels, read back and compared with exact motions."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from analytic import run_here, save, turning
from problems import MOTIONS, ExactMotion
from scipy.spatial.transform import Rotation

from nsm.cli.errors import InputError
from nsm.export import __main__ as export
from nsm.export.formats import FORMATS
from nsm.export.request import Request
from nsm.morphs.file_coordinates import FileCoordinates
from nsm.shapes import Ball, Similarity

nibabel = pytest.importorskip("nibabel")
nrrd = pytest.importorskip("nrrd")
tifffile = pytest.importorskip("tifffile")
pyvista = pytest.importorskip("pyvista")

TIMES = [0.0, 0.3]
POSE = {"rotation": [20, -35, 50], "translation": [0.1, 0.2, 0.0], "scale": 0.02}


def placed(name: str, dim: int) -> ExactMotion:
    """A motion whose source has a file of other units, turned and moved."""
    motion = MOTIONS[name](dim)
    pose = POSE if dim == 3 else {"rotation": 25, "translation": [7.0, -3.0], "scale": 0.02}
    motion.source = Ball(0.4, motion.start.tolist(), pose=pose)
    return motion


def write(motion: ExactMotion, format: str, output: Path, **settings) -> None:
    FORMATS[format].export(Request(motion, output, settings.pop("times", TIMES), **settings))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("coordinates", ["morph", "source"])
def test_fields_in_nrrd_are_those_of_the_morph(dim: int, coordinates: str, tmp_path: Path) -> None:
    motion = placed("squashed_ball", dim)
    write(motion, "nrrd", tmp_path, resolution=6, coordinates=coordinates)
    exact = motion if coordinates == "morph" else FileCoordinates(motion, "source")
    for number, time in enumerate(TIMES):
        values, header = nrrd.read(str(tmp_path / f"f_{number:04d}.nrrd"))
        assert float(header["t"]) == time
        index = np.argwhere(np.ones_like(values))
        places = torch.from_numpy(header["space origin"] + index @ header["space directions"])
        assert values.ravel() == pytest.approx(exact(places, time).numpy(), rel=1e-5, abs=1e-5)
        vectors, header = nrrd.read(str(tmp_path / f"velocity_{number:04d}.nrrd"))
        assert header["kinds"] == ["vector"] + ["domain"] * dim
        velocity = vectors.reshape(dim, -1).T
        assert velocity == pytest.approx(exact.velocity(places, time).numpy(), rel=1e-4, abs=1e-4)
    record = json.loads((tmp_path / "fields.json").read_text())
    assert record["files"] == [[f"f_000{n}.nrrd", f"velocity_000{n}.nrrd"] for n in range(2)]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("coordinates", ["morph", "source"])
def test_fields_in_vti_are_those_of_the_morph(dim: int, coordinates: str, tmp_path: Path) -> None:
    motion = placed("squashed_ball", dim)
    write(motion, "vti", tmp_path, resolution=6, coordinates=coordinates)
    exact = motion if coordinates == "morph" else FileCoordinates(motion, "source")
    for number, time in enumerate(TIMES):
        image = pyvista.read(tmp_path / f"fields_{number:04d}.vti")
        assert image.field_data["TimeValue"] == [time]
        places = torch.from_numpy(image.points[:, :dim].astype(np.float64))
        assert image.point_data["f"] == pytest.approx(exact(places, time).numpy(), rel=1e-4, abs=1e-4)
        found = image.point_data["velocity"]
        assert found[:, :dim] == pytest.approx(exact.velocity(places, time).numpy(), rel=1e-4, abs=1e-4)
        assert (found[:, dim:] == 0).all()


def test_a_grid_in_a_scanner_is_named_after_it(tmp_path: Path) -> None:
    motion = placed("translating_ball", 3)
    motion.provenance = {"source": {"kind": "labels", "path": "brain.nii.gz"}}
    write(motion, "nrrd", tmp_path, resolution=3, coordinates="source", times=[0.0])
    header = nrrd.read_header(str(tmp_path / "velocity_0000.nrrd"))
    assert header["space"] == "right-anterior-superior"
    assert header["space units"] == ["mm"] * 3


def voxels(motion: ExactMotion, affine: np.ndarray, count: int, time: float = 0.0) -> np.ndarray:
    """The ball of a motion in the voxels of a scanner: 5 inside, 9 in its core, and 0 outside."""
    index = np.argwhere(np.ones([count] * 3))
    scanner = torch.from_numpy(index @ affine[:3, :3].T + affine[:3, 3])
    value = motion(motion.source.similarity.apply(scanner), time).numpy().reshape([count] * 3)
    return np.where(value < -0.2, 9, np.where(value < 0, 5, 0)).astype(np.int16)


def scanner(turned: bool) -> np.ndarray:
    """Places of voxels of 2.5 mm, 1/20 of the box of the morph, around the middle of the box."""
    affine = np.eye(4)
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix() if turned else Similarity.read(POSE, 3).rotation.T.numpy()
    affine[:3, :3] = turn @ np.diag([-1, 1, 1]) * 2.5
    middle = Similarity.read(POSE, 3).inverse().apply(torch.zeros(1, 3, dtype=torch.float64))[0].numpy()
    affine[:3, 3] = middle - affine[:3, :3] @ np.full(3, 19.5)
    return affine


def test_labels_of_a_ball_that_moves_by_whole_voxels_are_exact(tmp_path: Path) -> None:
    motion, affine = placed("translating_ball", 3), scanner(turned=False)
    motion.drift = torch.tensor([0.4, 0.3, -0.2], dtype=torch.float64)  # 8, 6, and 4 voxels
    given = voxels(motion, affine, 40)
    nibabel.save(nibabel.Nifti1Image(given, affine), tmp_path / "a.nii.gz")
    write(motion, "labels", tmp_path / "o", times=[0.0, 0.5, 1.0], labels=str(tmp_path / "a.nii.gz"),
          coordinates="source", resolution=8)  # fmt: skip
    for number, shift in enumerate([(0, 0, 0), (-4, 3, -2), (-8, 6, -4)]):
        image = nibabel.load(tmp_path / "o" / f"labels_{number:04d}.nii.gz")
        assert np.array_equal(image.affine, nibabel.load(tmp_path / "a.nii.gz").affine)
        assert image.get_data_dtype() == np.int16
        assert np.array_equal(np.asarray(image.dataobj), np.roll(given, shift, axis=(0, 1, 2)))
    volumes = json.loads((tmp_path / "o" / "labels.json").read_text())["volumes"]
    assert volumes["5"]["at_times"] == [pytest.approx(2.5**3 * (given == 5).sum())] * 3


def test_carried_labels_are_the_moving_ball_within_a_voxel(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    motion, affine = placed("translating_ball", 3), scanner(turned=True)
    given = voxels(motion, affine, 40)
    nrrd.write(str(tmp_path / "a.nrrd"), given, {"space directions": affine[:3, :3].T, "space origin": affine[:3, 3],
               "space": "right-anterior-superior"})  # fmt: skip
    with caplog.at_level("INFO"):
        write(motion, "labels", tmp_path, times=[1.0], labels=str(tmp_path / "a.nrrd"), coordinates="source",
              resolution=8)  # fmt: skip
    found, header = nrrd.read(str(tmp_path / "labels_0000.nrrd"))
    assert header["space"] == "right-anterior-superior"
    assert np.allclose(header["space directions"], affine[:3, :3].T)
    exact = voxels(motion, affine, 40, time=1.0)
    for level, labels in ((0.0, (5, 9)), (-0.2, (9,))):
        radius = (0.4 + level) * 50
        volume = 2.5**3 * np.isin(found, labels).sum()
        assert volume == pytest.approx(4 / 3 * math.pi * radius**3, rel=0.02)  # as near as the voxels of the ball are
        wrong = np.isin(found, labels) != np.isin(exact, labels)
        index = torch.from_numpy(np.argwhere(wrong) @ affine[:3, :3].T + affine[:3, 3])
        away = (motion(motion.source.similarity.apply(index), 1.0) - level).abs() / 0.05
        assert away.max() < math.sqrt(3) / 2 + 1e-3  # no farther from the sphere than half the diagonal of a voxel
    assert "the flow of V is accurate to" in caplog.text


def test_labels_of_the_target_are_carried_backward(tmp_path: Path) -> None:
    motion, affine = placed("rotating_box", 3), scanner(turned=False)
    motion.target = motion.source
    at_end = voxels(motion, affine, 40, time=1.0)
    tifffile.imwrite(tmp_path / "a.tif", np.ascontiguousarray(at_end.T), photometric="minisblack")
    motion.target = Ball(0.4, pose=Similarity.read(POSE, 3).after(_placing(affine)))
    write(motion, "labels", tmp_path, times=[0.0], labels=str(tmp_path / "a.tif"), coordinates="target", resolution=24)
    found, exact = tifffile.imread(tmp_path / "labels_0000.tif").T, voxels(motion, affine, 40)
    assert (found != 0).sum() == pytest.approx((exact != 0).sum(), rel=0.02)
    assert ((found != 0) != (exact != 0)).sum() < 0.06 * (exact != 0).sum()
    assert ((at_end != 0) != (exact != 0)).sum() > 0.3 * (exact != 0).sum()  # it turned far


def test_the_command_carries_labels_of_the_source_and_samples_its_fields(tmp_path: Path) -> None:
    file = save(turning(3, math.pi / 2, Ball(20.0, [0.0] * 3, pose={"scale": 0.02})), tmp_path / "a.ckpt")
    given = np.zeros([25] * 3, np.uint8)
    given[14:17, 11:14, 10:13] = 4
    affine = np.diag([2.0, 2.0, 2.0, 1.0])
    affine[:3, 3] = -24
    nibabel.save(nibabel.Nifti1Image(given, affine), tmp_path / "a.nii.gz")
    command = (f"checkpoint={file}", "times=[1]", f"labels={tmp_path}/a.nii.gz", f"output={tmp_path}/o")
    assert run_here(export, *command, "format=labels", "resolution=12") == 0
    found = np.asarray(nibabel.load(tmp_path / "o" / "labels_0000.nii.gz").dataobj)
    assert np.array_equal(found, np.rot90(given, axes=(0, 1)))
    command = (f"checkpoint={file}", "times=[1]", f"output={tmp_path}/o", "resolution=4", "coordinates=source")
    assert run_here(export, *command, "format=vti") == 0
    image = pyvista.read(tmp_path / "o" / "fields_0000.vti")
    assert image.bounds == pytest.approx((-50, 50) * 3)
    turned = np.pi / 2 * np.stack([-image.points[:, 1], image.points[:, 0], 0 * image.points[:, 2]], 1)
    assert image.point_data["velocity"] == pytest.approx(turned, abs=0.01)  # mm per unit of t


def _placing(affine: np.ndarray) -> Similarity:
    """The similarity of voxels, as a file that says nothing of its place is read."""
    matrix = torch.from_numpy(affine[:3, :3]) / 2.5
    return Similarity(matrix, torch.from_numpy(affine[:3, 3].copy()), 2.5)


def test_labels_that_cannot_be_carried(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    motion = placed("translating_ball", 3)
    with pytest.raises(InputError, match=r"`labels` must be a volume of labels for `format=labels`, got nothing"):
        write(motion, "labels", tmp_path, coordinates="source")
    affine = scanner(turned=False)
    nibabel.save(nibabel.Nifti1Image(np.full([6] * 3, 7, np.uint8), 30 * affine), tmp_path / "far.nii")
    with pytest.raises(InputError, match=r"`coordinates` must be source or target for `format=labels`"):
        write(motion, "labels", tmp_path, labels=str(tmp_path / "far.nii"))
    with pytest.raises(InputError, match=r"`morph` must have a target with a file"):
        write(motion, "labels", tmp_path, labels=str(tmp_path / "far.nii"), coordinates="target")
    write(motion, "labels", tmp_path, labels=str(tmp_path / "far.nii"), coordinates="source", resolution=4, times=[0])
    assert "of the labeled voxels lie outside of the box of the morph" in caplog.text
