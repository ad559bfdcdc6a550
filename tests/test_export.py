"""The command that writes meshes: round trips, coordinates, frames that are not there, and its sentences."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from analytic import FREQUENCY, bowl, run_here, save, sentence, shrinking, unreadable

from nsm import export
from nsm.fields import SourceInit
from nsm.morph import NeuralMorph
from nsm.shapes import Ball, Similarity, SirenShape, equal_volume

POSE = {"rotation": [20, -35, 50], "translation": [0.1, -0.05, 0.08], "scale": 0.7}


@pytest.fixture(autouse=True)
def _somewhere_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def _names(folder: Path) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())


def _mesh(file: Path) -> trimesh.Trimesh:
    mesh = trimesh.load(file, force="mesh", process=False)
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def _normals(file: Path) -> np.ndarray:
    """Vertex normals as a PLY file holds them (trimesh makes its own)."""
    header, _, data = file.read_bytes().partition(b"end_header\n")
    count = int(re.search(rb"element vertex (\d+)", header)[1])
    return np.frombuffer(data, "<f4", count * 6).reshape(count, 6)[:, 3:].astype(np.float64)


def test_a_run_becomes_a_sequence_of_its_surfaces(tmp_path: Path) -> None:
    morph = shrinking(3, 0.2)
    run = tmp_path / "run"
    save(morph, run / "checkpoints" / "best.ckpt")
    assert run_here(export, f"checkpoint={run}", "times=3", "resolution=24") == 0
    assert _names(run / "export") == ["frame_0000.ply", "frame_0001.ply", "frame_0002.ply"]
    for number, time in enumerate((0.0, 0.5, 1.0)):
        frame = run / "export" / f"frame_{number:04d}.ply"
        mesh = _mesh(frame)
        assert mesh.is_watertight
        vertices = torch.tensor(np.array(mesh.vertices), dtype=torch.float32)
        assert morph(vertices, time).abs().max() < 0.01
        gradient = morph.gradient(vertices, time)
        cosine = (gradient / gradient.norm(dim=1, keepdim=True) * torch.tensor(_normals(frame))).sum(1)
        assert cosine.min() > 0.9999


@pytest.mark.parametrize("suffix", ["obj", "stl"])
def test_other_formats_and_chosen_times(suffix: str, tmp_path: Path) -> None:
    file = save(shrinking(3, 0.2), tmp_path / "a.ckpt")
    assert (
        run_here(export, f"checkpoint={file}", "times=[0.25,1]", f"format={suffix}", "resolution=12", "output=o") == 0
    )
    assert _names(tmp_path / "o") == [f"frame_0000.{suffix}", f"frame_0001.{suffix}"]
    assert _mesh(tmp_path / "o" / f"frame_0000.{suffix}").volume > _mesh(tmp_path / "o" / f"frame_0001.{suffix}").volume


def test_curves_are_written_as_lines(tmp_path: Path) -> None:
    file = save(shrinking(2, 0.2), tmp_path / "a.ckpt")
    assert run_here(export, f"checkpoint={file}", "times=2", "resolution=24") == 0
    assert _names(tmp_path / "export") == ["frame_0000.obj", "frame_0001.obj"]


@pytest.mark.parametrize("larger", ["source", "target"])
def test_in_the_coordinates_of_a_file_its_fit_pose_and_scale_are_undone(larger: str, tmp_path: Path) -> None:
    # as a mesh file gives it: a network in the box, and the similarity that took the file there
    own = bowl(3, 2.5)
    place = Similarity.read(POSE, 3)
    shape = SirenShape.from_network(own).transformed(place)
    other = Ball(0.42) if larger == "source" else Ball(0.7)
    ends = equal_volume(shape, other)
    assert (ends.source_scale < 1) == (larger == "source")
    morph = NeuralMorph(bowl(3, 2.5, 0.0), None, ends.source, ends.target).requires_grad_(False)
    SourceInit()(morph.field, ends.source.network)
    assert ends.source.provenance()["similarity"] == morph.source.similarity.to_config()
    file = save(morph, tmp_path / "a.ckpt")

    for frame in ("morph", "source", "target"):
        settings = ("times=1", "resolution=64", f"frame={frame}", f"output={frame}")
        assert run_here(export, f"checkpoint={file}", *settings) == 0
    here, there, opposite = (_mesh(tmp_path / f / "frame_0000.ply") for f in ("morph", "source", "target"))

    # the surface of the file, Σ cos(k y) = 5/2, and the normals that point away from it
    vertices, normals = np.array(there.vertices), _normals(tmp_path / "source" / "frame_0000.ply")
    assert np.abs(np.cos(FREQUENCY * vertices).sum(1) - 2.5).max() < 2e-3
    gradient = np.sin(FREQUENCY * vertices)
    assert ((gradient * normals).sum(1) / np.linalg.norm(gradient, axis=1)).min() > 0.9999
    total = ends.source_scale * 0.7
    assert here.volume == pytest.approx(total**3 * there.volume, rel=1e-4)
    assert np.allclose(opposite.vertices, np.array(here.vertices) / ends.target_scale, atol=1e-5)
    # a box in the coordinates of the file: no rotation is left
    assert np.ptp(vertices, axis=0) == pytest.approx(np.ptp(vertices, axis=0)[0] * np.ones(3), rel=1e-2)


def test_a_time_without_surface_is_left_out_and_said(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = save(shrinking(2, 0.8), tmp_path / "a.ckpt")
    stale = tmp_path / "export" / "frame_0002.obj"
    stale.parent.mkdir()
    stale.write_text("of an earlier sequence")
    assert run_here(export, f"checkpoint={file}", "times=3", "resolution=16") == 0
    assert _names(tmp_path / "export") == ["frame_0000.obj"]
    said = sentence("".join(capfd.readouterr()))
    assert "there is no surface at t = 0.5: frame_0001.obj is left out" in said
    assert "there is no surface at t = 1: frame_0002.obj is left out" in said
    assert "wrote 1 of 3 frames" in said


def test_a_morph_without_any_surface(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = save(shrinking(2, 0.8), tmp_path / "a.ckpt")
    assert run_here(export, f"checkpoint={file}", "times=[1]", "resolution=16") == 2
    assert "has no surface at any of the 1 times" in sentence(capfd.readouterr().err)
    assert _names(tmp_path) == ["a.ckpt"]


def test_frames_of_a_longer_sequence_are_not_mixed_in(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    command = (f"checkpoint={save(shrinking(2, 0.2), tmp_path / 'a.ckpt')}", "resolution=12")
    assert run_here(export, *command, "times=3") == 0
    before = [(p, p.read_bytes()) for p in sorted((tmp_path / "export").iterdir())]
    assert run_here(export, *command, "times=2") == 2
    assert "frames of a longer sequence (frame_0002.obj" in sentence(capfd.readouterr().err)
    assert [(p, p.read_bytes()) for p in sorted((tmp_path / "export").iterdir())] == before
    assert run_here(export, *command, "times=3") == 0


@pytest.mark.parametrize("ailment", ["missing", "cut", "text", "not ours", "format", "no run"])
def test_what_is_no_checkpoint(ailment: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file, words = unreadable(tmp_path)[ailment]
    before = _names(tmp_path)
    assert run_here(export, f"checkpoint={file}", "output=frames") == 2
    assert words in sentence(capfd.readouterr().err)
    assert _names(tmp_path) == before


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("checkpoint=null",), "no morph is named: type python -m nsm.export checkpoint=PATH"),
        (("times=0",), "times=0 names no times"),
        (("times=-3",), "times=-3 names no times"),
        (("times=2.5",), "times=2.5 names no times"),
        (("times=[]",), "names no times"),
        (("times=[0,1.5]",), "names no times: give how many"),
        (("times=many",), "times=many names no times"),
        (("resolution=0",), "resolution=0 cannot be"),
        (("format=gltf",), "format=gltf cannot be written: give one of ply, obj, stl"),
        (("format=ply",), "this morph is 2D: give format=obj"),
        (("frame=world",), "frame=world is not known: give one of morph, source, target"),
        (("threads=-1",), "threads=-1"),
        (("checkpoint=null", "official=cow_dog"), "official=cow_dog is no morph that the authors published"),
        (("output=a.ckpt",), "cannot be written"),
    ],
)
def test_what_cannot_be_exported(
    overrides: tuple[str, ...], words: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = save(shrinking(2, 0.1), tmp_path / "a.ckpt")
    assert run_here(export, f"checkpoint={file}", *overrides) == 2
    assert words in sentence(capfd.readouterr().err)
    assert _names(tmp_path) == ["a.ckpt"]


def test_one_morph_at_a_time(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    files = [save(shrinking(2, rise), tmp_path / f"{rise}.ckpt") for rise in (0.1, 0.2)]
    assert run_here(export, f"checkpoint=[{files[0]},{files[1]}]") == 2
    assert "2 morphs are named, but one is exported at a time" in sentence(capfd.readouterr().err)
