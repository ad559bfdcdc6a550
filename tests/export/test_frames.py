"""Frames of an export: round trips, coordinates, missing surfaces, exact volumes, and interrupted exports."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import torch
import trimesh
from analytic import FREQUENCY, bowl, run_here, save, sentence, shrinking
from folders import names, read_mesh

from nsm.export import __main__ as export
from nsm.export import surfaces
from nsm.fields import SourceInit
from nsm.io.checkpoint import load_morph
from nsm.morphs import surfaces as frames
from nsm.morphs.neural import NeuralMorph
from nsm.shapes import Ball, MeshFile, Similarity, SirenShape, equal_volume
from nsm.train.tasks import SdfFit, prepare_keys

ROOT = Path(__file__).resolve().parents[2]

POSE = {"rotation": [20, -35, 50], "translation": [0.1, -0.05, 0.08], "scale": 0.7}


@pytest.fixture(autouse=True)
def _somewhere_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


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
    assert names(run / "export") == [*(f"frame_000{n}.ply" for n in range(3)), "frames.json"]
    for number, moment in enumerate((0.0, 0.5, 1.0)):
        frame = run / "export" / f"frame_{number:04d}.ply"
        mesh = read_mesh(frame)
        assert mesh.is_watertight
        vertices = torch.tensor(np.array(mesh.vertices), dtype=torch.float32)
        assert morph(vertices, moment).abs().max() < 0.01
        gradient = morph.gradient(vertices, moment)
        cosine = (gradient / gradient.norm(dim=1, keepdim=True) * torch.tensor(_normals(frame))).sum(1)
        assert cosine.min() > 0.9999


@pytest.mark.parametrize("suffix", ["obj", "stl"])
def test_other_formats_and_chosen_times(suffix: str, tmp_path: Path) -> None:
    file = save(shrinking(3, 0.2), tmp_path / "a.ckpt")
    assert (
        run_here(export, f"checkpoint={file}", "times=[0.25,1]", f"format={suffix}", "resolution=12", "output=o") == 0
    )
    assert names(tmp_path / "o") == [f"frame_0000.{suffix}", f"frame_0001.{suffix}", "frames.json"]
    assert (
        read_mesh(tmp_path / "o" / f"frame_0000.{suffix}").volume
        > read_mesh(tmp_path / "o" / f"frame_0001.{suffix}").volume
    )


def test_curves_are_written_as_lines(tmp_path: Path) -> None:
    file = save(shrinking(2, 0.2), tmp_path / "a.ckpt")
    assert run_here(export, f"checkpoint={file}", "times=2", "resolution=24") == 0
    assert names(tmp_path / "export") == ["frame_0000.obj", "frame_0001.obj", "frames.json"]


@pytest.mark.parametrize("larger", ["source", "target"])
def test_in_the_coordinates_of_a_file_its_fit_pose_and_scale_are_undone(larger: str, tmp_path: Path) -> None:
    # as a mesh file gives it: a network in the box, and the similarity that took the file there
    own = bowl(3, 2.5)
    place = Similarity.read(POSE, 3)
    shape = SirenShape.from_network(own).transformed(place)
    other = Ball(0.42) if larger == "source" else Ball(0.7)
    ends = equal_volume(shape, other)
    assert (ends.scales[0] < 1) == (larger == "source")
    morph = NeuralMorph(bowl(3, 2.5, 0.0), None, *ends.shapes).requires_grad_(False)
    SourceInit()(morph.field, ends.shapes[0].folded())
    assert ends.shapes[0].provenance()["similarity"] == morph.source.similarity.to_config()
    file = save(morph, tmp_path / "a.ckpt")

    for frame in ("morph", "source", "target"):
        settings = ("times=1", "resolution=64", f"coordinates={frame}", f"output={frame}")
        assert run_here(export, f"checkpoint={file}", *settings) == 0
    here, there, opposite = (read_mesh(tmp_path / f / "frame_0000.ply") for f in ("morph", "source", "target"))

    # the surface of the file, Σ cos(k y) = 5/2, and the normals that point away from it
    vertices, normals = np.array(there.vertices), _normals(tmp_path / "source" / "frame_0000.ply")
    assert np.abs(np.cos(FREQUENCY * vertices).sum(1) - 2.5).max() < 2e-3
    gradient = np.sin(FREQUENCY * vertices)
    assert ((gradient * normals).sum(1) / np.linalg.norm(gradient, axis=1)).min() > 0.9999
    total = ends.scales[0] * 0.7
    assert here.volume == pytest.approx(total**3 * there.volume, rel=1e-4)
    assert np.allclose(opposite.vertices, np.array(here.vertices) / ends.scales[1], atol=1e-5)
    # a box in the coordinates of the file: no rotation is left
    assert np.ptp(vertices, axis=0) == pytest.approx(np.ptp(vertices, axis=0)[0] * np.ones(3), rel=1e-2)


@pytest.mark.parametrize("scale", [0.001, 1000.0])
def test_a_mesh_in_any_units_and_place_gets_its_own_coordinates_and_volume_back(scale: float, tmp_path: Path) -> None:
    rows = trimesh.creation.icosphere(3)
    vertices = scale * rows.vertices * np.array([0.5, 0.3, 0.8]) + 100
    lines = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in vertices]
    (tmp_path / "a.obj").write_text("\n".join(lines + [f"f {a} {b} {c}" for a, b, c in rows.faces + 1]) + "\n")
    ends = prepare_keys([MeshFile(str(tmp_path / "a.obj")), Ball(0.3)], mock.Mock(spec=SdfFit))
    morph = NeuralMorph(bowl(3, 2.5, 0.0), None, ends.source, ends.target).requires_grad_(False)
    file = save(morph, tmp_path / "a.ckpt", provenance=ends.provenance)
    (tmp_path / "a.obj").unlink()  # the checkpoint holds the mesh
    loaded = load_morph(file)
    torch.testing.assert_close(loaded.source(torch.eye(3)), ends.source(torch.eye(3)))
    for frame in ("morph", "source"):
        settings = ("times=1", "resolution=32", f"coordinates={frame}", f"output={tmp_path}/{frame}")
        assert run_here(export, f"checkpoint={file}", *settings) == 0
    here, there = (np.array(read_mesh(tmp_path / f / "frame_0000.ply").vertices) for f in ("morph", "source"))
    box = ends.source.exact_bounds().numpy()
    back = (here - box[0]) / (box[1] - box[0]) * np.ptp(vertices, axis=0) + vertices.min(0)
    assert np.abs(back - there).max() < 2e-6 * scale
    volumes = [read_mesh(tmp_path / f / "frame_0000.ply").volume for f in ("morph", "source")]
    assert volumes[1] == pytest.approx(volumes[0] * ends.source.similarity.scale**-3, rel=1e-3)


def test_a_time_without_surface_is_skipped_with_a_warning(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = save(shrinking(2, 0.8), tmp_path / "a.ckpt")
    assert run_here(export, f"checkpoint={file}", "times=3", "resolution=16") == 0
    assert names(tmp_path / "export") == ["frame_0000.obj", "frames.json"]
    said = sentence("".join(capfd.readouterr()))
    assert "skipped frame_0001.obj: there is no surface at t = 0.5" in said
    assert "skipped frame_0002.obj: there is no surface at t = 1" in said
    assert "wrote 1 of 3 frames" in said


def test_a_morph_without_any_surface(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = save(shrinking(2, 0.8), tmp_path / "a.ckpt")
    assert run_here(export, f"checkpoint={file}", "times=[1]", "resolution=16") == 2
    assert "must have a surface at one of the 1 times, got none" in sentence(capfd.readouterr().err)
    assert names(tmp_path) == ["a.ckpt"]


def test_frames_of_another_export_are_not_mixed_in(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = save(shrinking(2, 0.2), tmp_path / "a.ckpt")
    command = (f"checkpoint={file}", "times=2", "resolution=12")
    assert run_here(export, *command) == 0
    before = [(p, p.read_bytes()) for p in sorted((tmp_path / "export").iterdir())]

    def refused(*others: str) -> str:
        assert run_here(export, *command, *others) == 2
        assert [(p, p.read_bytes()) for p in sorted((tmp_path / "export").iterdir())] == before
        return sentence(capfd.readouterr().err)

    assert "whose frames have times=[0.0, 1.0] instead of [0.0, 0.5, 1.0]" in refused("times=3")
    said = refused("resolution=16", "coordinates=target")
    assert 'resolution=12 instead of 16, coordinates="morph" instead of "target". Try another `output`' in said
    assert "growth=" in refused("growth=smooth_step", "growth.source=1", "growth.target=0.8")
    save(shrinking(2, 0.21), file)  # the morph itself is another one
    assert "whose frames have morph=" in refused()
    (tmp_path / "export" / "frames.json").write_text("{")
    assert run_here(export, *command) == 2
    assert "frames.json must be the record of an export" in sentence(capfd.readouterr().err)
    (tmp_path / "export" / "frames.json").unlink()
    assert run_here(export, *command) == 2
    assert "which holds frame_0000.obj but no frames.json" in sentence(capfd.readouterr().err)


@pytest.mark.parametrize("kind", ["obj", "glb"])
def test_an_interrupted_export_goes_on(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    file = save(shrinking(3, 0.2), tmp_path / "a.ckpt")
    command = (f"checkpoint={file}", "times=4", "resolution=12", f"format={kind}")
    made: list[float] = []

    def until(last: float):
        def extract(morph, time: float, resolution: int, level: float = 0.0):
            if time > last:
                raise KeyboardInterrupt
            made.append(time)
            return frames.extract_frame(morph, time, resolution, level)

        monkeypatch.setattr(surfaces, "extract_frame", extract)
        return run_here(export, *command, f"output={tmp_path}/o")

    assert until(0.5) == 128 + signal.SIGINT
    assert made == pytest.approx([0, 1 / 3])
    assert not list((tmp_path / "o").glob("*.glb"))
    assert until(1.0) == 0
    assert made == pytest.approx([0, 1 / 3, 2 / 3, 1])
    present = [p.name for p in sorted((tmp_path / "o").iterdir())]
    frames_there = [f"frame_000{n}.obj" for n in range(4)]
    assert present == ([*frames_there, "frames.json"] if kind == "obj" else ["morph.glb", "morph.glb.json"])
    # as if there had been no interruption
    assert run_here(export, *command, f"output={tmp_path}/whole") == 0
    for name in present:
        assert (tmp_path / "o" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    if kind == "obj":
        capfd.readouterr()
        assert until(1.0) == 0
        assert len(made) == 8
        assert "wrote 4 of 4 frames" in sentence("".join(capfd.readouterr()))


def test_a_killed_export_leaves_whole_frames_and_goes_on(tmp_path: Path) -> None:
    file = save(shrinking(3, 0.2), tmp_path / "a.ckpt")
    arguments = [f"checkpoint={file}", "times=16", "resolution=40", "threads=1", f"output={tmp_path}/o"]
    killed = subprocess.Popen([sys.executable, "-m", "nsm.export", *arguments], cwd=ROOT, stderr=subprocess.DEVNULL)
    while not (tmp_path / "o" / "frame_0002.ply").exists():
        assert killed.poll() is None
        time.sleep(0.01)
    killed.kill()
    killed.wait()
    there = {p.name: p.stat().st_mtime_ns for p in (tmp_path / "o").glob("frame_*.ply")}
    kept = json.loads((tmp_path / "o" / "frames.json").read_text())["frames"]
    assert 2 <= len(kept) < 16
    for entry in kept.values():
        assert read_mesh(tmp_path / "o" / entry["file"]).is_watertight
    assert run_here(export, *arguments) == 0
    after = {p.name: p.stat().st_mtime_ns for p in (tmp_path / "o").glob("frame_*.ply")}
    assert len(after) == 16
    assert all(after[entry["file"]] == there[entry["file"]] for entry in kept.values())


def test_frames_of_exact_volume(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = save(shrinking(3, 0.05), tmp_path / "a.ckpt")
    command = (f"checkpoint={file}", "times=2", "resolution=24")
    assert run_here(export, *command, "exact_volume=true", "output=exact") == 0
    said = sentence("".join(capfd.readouterr()))
    first, last = (read_mesh(tmp_path / "exact" / f"frame_000{n}.ply").volume for n in range(2))
    assert last == pytest.approx(first, rel=1e-4)
    records = json.loads((tmp_path / "exact" / "frames.json").read_text())["frames"]
    assert [records[n]["time"] for n in "01"] == [0, 1]
    assert [records[n]["components"] for n in "01"] == [1, 1]
    assert records["1"]["volume"] == pytest.approx(last, rel=1e-5)
    # f rises by 0.05 from t = 0 to t = 1, so the level does too
    assert records["1"]["level"] - records["0"]["level"] == pytest.approx(0.05, abs=1e-4)
    assert "largest level: 0.05" in said
    assert "at t = 1 is large: the morph does not preserve its volume there" in said
    assert run_here(export, *command, "output=zero") == 0
    assert "largest level" not in "".join(capfd.readouterr())
    assert read_mesh(tmp_path / "zero" / "frame_0001.ply").volume < 0.97 * first


def test_frames_of_a_growing_morph(tmp_path: Path) -> None:
    file = save(shrinking(3, 0.0), tmp_path / "a.ckpt")
    growth = ("growth=volume_linear", "growth.source=1", "growth.target=0.5")
    assert run_here(export, f"checkpoint={file}", "times=2", "resolution=32", "exact_volume=true", *growth) == 0
    first, last = (read_mesh(tmp_path / "export" / f"frame_000{n}.ply").volume for n in range(2))
    assert last == pytest.approx(first / 2, rel=1e-4)
