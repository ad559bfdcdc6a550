"""The command that writes meshes: round trips, coordinates, frames that are not there, and its sentences."""

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
from analytic import FREQUENCY, bowl, run_here, save, sentence, shrinking, turning, unreadable

from nsm.export import __main__ as export
from nsm.export import surfaces
from nsm.fields import SourceInit
from nsm.io.checkpoint import load_morph
from nsm.io.mesh import write_mesh
from nsm.morphs import surfaces as frames
from nsm.morphs.neural import NeuralMorph
from nsm.morphs.surfaces import extract_frame
from nsm.shapes import Ball, MeshFile, Similarity, SirenShape, equal_volume, primitive
from nsm.shapes.textured import Attributes
from nsm.train.tasks import SdfFit, prepare_ends

ROOT = Path(__file__).resolve().parents[2]
#: Radians by which the carried ball turns.
SPIN = 0.7

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
    assert _names(run / "export") == [*(f"frame_000{n}.ply" for n in range(3)), "frames.json"]
    for number, moment in enumerate((0.0, 0.5, 1.0)):
        frame = run / "export" / f"frame_{number:04d}.ply"
        mesh = _mesh(frame)
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
    assert _names(tmp_path / "o") == [f"frame_0000.{suffix}", f"frame_0001.{suffix}", "frames.json"]
    assert _mesh(tmp_path / "o" / f"frame_0000.{suffix}").volume > _mesh(tmp_path / "o" / f"frame_0001.{suffix}").volume


def test_curves_are_written_as_lines(tmp_path: Path) -> None:
    file = save(shrinking(2, 0.2), tmp_path / "a.ckpt")
    assert run_here(export, f"checkpoint={file}", "times=2", "resolution=24") == 0
    assert _names(tmp_path / "export") == ["frame_0000.obj", "frame_0001.obj", "frames.json"]


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
    SourceInit()(morph.field, ends.source.folded())
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


@pytest.mark.parametrize("scale", [0.001, 1000.0])
def test_a_mesh_in_any_units_and_place_gets_its_own_coordinates_and_volume_back(scale: float, tmp_path: Path) -> None:
    rows = trimesh.creation.icosphere(3)
    vertices = scale * rows.vertices * np.array([0.5, 0.3, 0.8]) + 100
    lines = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in vertices]
    (tmp_path / "a.obj").write_text("\n".join(lines + [f"f {a} {b} {c}" for a, b, c in rows.faces + 1]) + "\n")
    ends = prepare_ends(MeshFile(str(tmp_path / "a.obj")), Ball(0.3), mock.Mock(spec=SdfFit))
    morph = NeuralMorph(bowl(3, 2.5, 0.0), None, ends.source, ends.target).requires_grad_(False)
    file = save(morph, tmp_path / "a.ckpt", provenance=ends.provenance)
    (tmp_path / "a.obj").unlink()  # the checkpoint holds the mesh
    loaded = load_morph(file)
    torch.testing.assert_close(loaded.source(torch.eye(3)), ends.source(torch.eye(3)))
    for frame in ("morph", "source"):
        settings = ("times=1", "resolution=32", f"frame={frame}", f"output={tmp_path}/{frame}")
        assert run_here(export, f"checkpoint={file}", *settings) == 0
    here, there = (np.array(_mesh(tmp_path / f / "frame_0000.ply").vertices) for f in ("morph", "source"))
    box = ends.source.exact_bounds().numpy()
    back = (here - box[0]) / (box[1] - box[0]) * np.ptp(vertices, axis=0) + vertices.min(0)
    assert np.abs(back - there).max() < 2e-6 * scale
    volumes = [_mesh(tmp_path / f / "frame_0000.ply").volume for f in ("morph", "source")]
    assert volumes[1] == pytest.approx(volumes[0] * ends.source.similarity.scale**-3, rel=1e-3)


def test_a_time_without_surface_is_left_out_and_said(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = save(shrinking(2, 0.8), tmp_path / "a.ckpt")
    assert run_here(export, f"checkpoint={file}", "times=3", "resolution=16") == 0
    assert _names(tmp_path / "export") == ["frame_0000.obj", "frames.json"]
    said = sentence("".join(capfd.readouterr()))
    assert "there is no surface at t = 0.5: frame_0001.obj is left out" in said
    assert "there is no surface at t = 1: frame_0002.obj is left out" in said
    assert "wrote 1 of 3 frames" in said


def test_a_morph_without_any_surface(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = save(shrinking(2, 0.8), tmp_path / "a.ckpt")
    assert run_here(export, f"checkpoint={file}", "times=[1]", "resolution=16") == 2
    assert "has no surface at any of the 1 times" in sentence(capfd.readouterr().err)
    assert _names(tmp_path) == ["a.ckpt"]


def test_frames_of_another_export_are_not_mixed_in(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = save(shrinking(2, 0.2), tmp_path / "a.ckpt")
    command = (f"checkpoint={file}", "times=2", "resolution=12")
    assert run_here(export, *command) == 0
    before = [(p, p.read_bytes()) for p in sorted((tmp_path / "export").iterdir())]

    def refused(*others: str) -> str:
        assert run_here(export, *command, *others) == 2
        assert [(p, p.read_bytes()) for p in sorted((tmp_path / "export").iterdir())] == before
        return sentence(capfd.readouterr().err)

    assert "frames of another export, with times=[0.0, 1.0] in place of [0.0, 0.5, 1.0]" in refused("times=3")
    said = refused("resolution=16", "frame=target")
    assert 'resolution=12 in place of 16, frame="morph" in place of "target": give another output' in said
    assert "growth=" in refused("growth=smooth_step", "growth.source=1", "growth.target=0.8")
    save(shrinking(2, 0.21), file)  # the morph itself is another one
    assert "with morph=" in refused()
    (tmp_path / "export" / "frames.json").write_text("{")
    assert run_here(export, *command) == 2
    assert "frames.json does not say" in sentence(capfd.readouterr().err)
    (tmp_path / "export" / "frames.json").unlink()
    assert run_here(export, *command) == 2
    assert "holds frame_0000.obj and no frames.json" in sentence(capfd.readouterr().err)


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
    names = [p.name for p in sorted((tmp_path / "o").iterdir())]
    frames_there = [f"frame_000{n}.obj" for n in range(4)]
    assert names == ([*frames_there, "frames.json"] if kind == "obj" else ["morph.glb", "morph.glb.json"])
    # as if there had been no interruption
    assert run_here(export, *command, f"output={tmp_path}/whole") == 0
    for name in names:
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
        assert _mesh(tmp_path / "o" / entry["file"]).is_watertight
    assert run_here(export, *arguments) == 0
    after = {p.name: p.stat().st_mtime_ns for p in (tmp_path / "o").glob("frame_*.ply")}
    assert len(after) == 16
    assert all(after[entry["file"]] == there[entry["file"]] for entry in kept.values())


def test_frames_of_exact_volume(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = save(shrinking(3, 0.05), tmp_path / "a.ckpt")
    command = (f"checkpoint={file}", "times=2", "resolution=24")
    assert run_here(export, *command, "exact_volume=true", "output=exact") == 0
    said = sentence("".join(capfd.readouterr()))
    first, last = (_mesh(tmp_path / "exact" / f"frame_000{n}.ply").volume for n in range(2))
    assert last == pytest.approx(first, rel=1e-4)
    records = json.loads((tmp_path / "exact" / "frames.json").read_text())["frames"]
    assert [records[n]["time"] for n in "01"] == [0, 1]
    assert [records[n]["components"] for n in "01"] == [1, 1]
    assert records["1"]["volume"] == pytest.approx(last, rel=1e-5)
    # f rises by 0.05 from t = 0 to t = 1, so the level does too
    assert records["1"]["level"] - records["0"]["level"] == pytest.approx(0.05, abs=1e-4)
    assert "largest level: 0.05" in said
    assert "at t = 1 is not small" in said
    assert run_here(export, *command, "output=zero") == 0
    assert "largest level" not in "".join(capfd.readouterr())
    assert _mesh(tmp_path / "zero" / "frame_0001.ply").volume < 0.97 * first


def test_frames_of_a_growing_morph(tmp_path: Path) -> None:
    file = save(shrinking(3, 0.0), tmp_path / "a.ckpt")
    growth = ("growth=volume_linear", "growth.source=1", "growth.target=0.5")
    assert run_here(export, f"checkpoint={file}", "times=2", "resolution=32", "exact_volume=true", *growth) == 0
    first, last = (_mesh(tmp_path / "export" / f"frame_000{n}.ply").volume for n in range(2))
    assert last == pytest.approx(first / 2, rel=1e-4)


def _pushed(tmp_path: Path) -> tuple[NeuralMorph, Path]:
    """A ball that turns about the third axis, as a checkpoint."""
    morph = turning(3, SPIN)
    return morph, save(morph, tmp_path / "turning.ckpt")


@pytest.mark.parametrize("kind", ["ply", "glb"])
def test_a_carried_surface_keeps_its_triangles_and_its_colors(kind: str, tmp_path: Path) -> None:
    _, file = _pushed(tmp_path)
    command = (f"checkpoint={file}", "times=[0,0.5,1]", "resolution=12", f"format={kind}", "output=o")
    # without projection: the velocity turns the surface, and f does not
    assert run_here(export, *command, "transport=true", "project=false") == 0
    folder = tmp_path / "o"
    with np.load(folder / "correspondences.npz") as found:
        start, end, faces = found["source_points"], found["target_points"], found["simplices"]
    turn = np.array([[np.cos(SPIN), -np.sin(SPIN), 0], [np.sin(SPIN), np.cos(SPIN), 0], [0, 0, 1]])
    assert np.allclose(np.linalg.norm(end, axis=1), 0.4, atol=0.03)  # on the target, as coarse as it is
    directions = (start @ turn.T) / np.linalg.norm(start, axis=1, keepdims=True)
    assert ((end / np.linalg.norm(end, axis=1, keepdims=True) * directions).sum(1)).min() > 0.99
    pair = [_mesh(folder / f"{end}.ply") for end in ("source", "target")]
    assert np.allclose(pair[0].vertices, start, atol=1e-6)
    assert (np.asarray(pair[0].visual.vertex_colors) == np.asarray(pair[1].visual.vertex_colors)).all()
    assert len(np.unique(np.asarray(pair[0].visual.vertex_colors), axis=0)) > 100
    if kind == "ply":
        meshes = [_mesh(folder / f"frame_000{n}.ply") for n in range(3)]
        assert all((mesh.faces == faces).all() for mesh in meshes)
        assert np.allclose(meshes[2].vertices, np.asarray(meshes[0].vertices) @ turn.T, atol=1e-3)
        assert (np.asarray(meshes[2].visual.vertex_colors) == np.asarray(pair[0].visual.vertex_colors)).all()
    else:
        assert {p.name for p in folder.iterdir()} >= {"morph.glb", "morph.glb.json"}
        assert not list(folder.glob(".*"))


def test_a_mesh_of_ones_own_is_carried_with_its_texture_coordinates(tmp_path: Path) -> None:
    morph, file = _pushed(tmp_path)
    surface = extract_frame(morph, 0.0, 10).mesh
    uv = torch.rand(len(surface.vertices), 2)
    write_mesh(tmp_path / "own.obj", surface, attributes=Attributes(uv=uv))
    command = (f"checkpoint={file}", "transport=true", "mesh=own.obj", "times=2", "resolution=10", "output=o")
    assert run_here(export, *command, "format=obj") == 0
    first, last = (_mesh(tmp_path / "o" / f"frame_000{n}.obj") for n in range(2))
    assert (first.faces == last.faces).all()
    assert np.allclose(first.visual.uv, last.visual.uv)
    assert np.allclose(np.sort(first.visual.uv[:, 0]), np.sort(uv[:, 0].numpy()), atol=1e-6)


@pytest.mark.parametrize("name", ["m.usdc", "m.usda", "folder"])
def test_usd_by_the_name_of_the_file(name: str, tmp_path: Path) -> None:
    file = save(shrinking(3, 0.2), tmp_path / "a.ckpt")
    command = (f"checkpoint={file}", "times=2", "resolution=8", "format=usd", f"output=o/{name}")
    assert run_here(export, *command) == 0
    expected = ["folder/morph.usdc", "folder/morph.usdc.json"] if name == "folder" else [name, f"{name}.json"]
    assert _names(tmp_path / "o") == expected


def test_fields_are_written_next_to_the_run(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    save(shrinking(2, 0.2), run / "checkpoints" / "best.ckpt")
    assert run_here(export, f"checkpoint={run}", "format=safetensors") == 0
    assert _names(run / "export") == ["morph.safetensors"]
    assert "wrote the fields to" in sentence("".join(capfd.readouterr()))


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
        (("checkpoint=null",), "Try `python -m nsm.export checkpoint=outputs/demo`"),
        (("times=0",), "`times` must be a number of times or a list of times from 0 to 1, got 0"),
        (("times=-3",), "`times` must be a number of times or a list of times from 0 to 1, got -3"),
        (("times=2.5",), "`times` must be a number of times or a list of times from 0 to 1, got 2.5"),
        (("times=[]",), "must be a number of times or a list of times"),
        (("times=[0,1.5]",), "`times` must be a number of times or a list of times from 0 to 1, got [0, 1.5]"),
        (("times=many",), "`times` must be a number of times or a list of times from 0 to 1, got many"),
        (("resolution=0",), "`resolution` must be an integer of at least 2, got 0"),
        (
            ("format=gltf",),
            "cannot be written: give one of ply, obj, stl, glb, usd, safetensors, pt2, onnx",
        ),
        (("format=safetensor",), "did you mean safetensors?"),
        (("format=ply",), "this morph is 2D: give one of obj, safetensors"),
        (("format=glb",), "this morph is 2D: give one of obj, safetensors"),
        (("exact_volume=yes",), "`exact_volume` must be true or false, got yes"),
        (("seconds=0",), "`seconds` must be positive and finite, got 0"),
        (("transport=true",), "has no velocity, so nothing can be carried"),
        (("transport=true", "exact_volume=true"), "leave out one of them"),
        (("mesh=ball.ply",), "add transport=true, or leave it out"),
        (("format=onnx", "exact_volume=true"), "format=onnx holds the fields, and exact_volume=true is about surfaces"),
        (("format=pt2", "frame=source"), "frame=source asks for others"),
        (("frame=world",), "frame=world is not known: give one of morph, source, target"),
        (("threads=-1",), "`threads` must be a positive integer, got -1"),
        (("ends=mesh",), "`ends` must be exact or network, got mesh. Try `ends=exact`."),
        (("checkpoint=null", "official=cow_dog"), "`official` must be one of kitten_fandisk"),
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


@pytest.mark.parametrize("ends", ["exact", "network"])
def test_the_first_frame_is_the_shape_or_what_the_network_makes_of_it(ends: str, tmp_path: Path) -> None:
    source = primitive.Box([0.7, 0.6, 0.5])
    morph = turning(3, SPIN, source)
    file = save(morph, tmp_path / "a.ckpt")
    command = (f"checkpoint={file}", "times=[0,0.5]", "resolution=32", f"ends={ends}", "output=o")
    assert run_here(export, *command) == 0
    vertices = torch.tensor(np.array(_mesh(tmp_path / "o" / "frame_0000.ply").vertices), dtype=torch.float32)
    away = {"exact": source(vertices), "network": morph(vertices, 0.0)}
    assert away[ends].abs().max() < 0.02
    assert away["exact" if ends == "network" else "network"].abs().max() > 0.1
    # a frame of other ends is another frame
    assert run_here(export, *command[:3], f"ends={'network' if ends == 'exact' else 'exact'}", "output=o") == 2


def test_formats_of_networks_hold_the_networks(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = save(turning(3, SPIN), tmp_path / "a.ckpt")
    assert run_here(export, f"checkpoint={file}", "format=safetensors", "output=o") == 0
    assert "format=safetensors holds the networks, so its ends are theirs" in sentence(capfd.readouterr().out)
    assert (tmp_path / "o" / "morph.safetensors").is_file()


def test_without_a_velocity_the_ends_are_those_of_the_network(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    morph = shrinking(3, 0.2)
    file = save(morph, tmp_path / "still" / "checkpoints" / "best.ckpt")
    assert run_here(export, f"checkpoint={file}", "times=[0]", "resolution=16", "output=o") == 0
    said = sentence(capfd.readouterr().out)
    assert "still has no velocity to advect detail, so its ends are those of the network" in said
    vertices = torch.tensor(np.array(_mesh(tmp_path / "o" / "frame_0000.ply").vertices), dtype=torch.float32)
    assert morph(vertices, 0.0).abs().max() < 0.02


def test_one_morph_at_a_time(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    files = [save(shrinking(2, rise), tmp_path / f"{rise}.ckpt") for rise in (0.1, 0.2)]
    assert run_here(export, f"checkpoint=[{files[0]},{files[1]}]") == 2
    assert "2 morphs are named, but one is exported at a time" in sentence(capfd.readouterr().err)
