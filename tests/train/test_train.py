"""The command from end to end: a small morph, and a mesh that becomes a network on the way."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from runs import BARE, DISK, STILL, TINY, files, train_here

from nsm.io.checkpoint import load_morph, load_shape
from nsm.morphs.neural import NeuralMorph
from nsm.shapes import Similarity
from nsm.train import callbacks
from nsm.train.tasks import MorphTask
from nsm.train.tasks.fit import SdfFit
from nsm.types import Morph

MESHES = {f"meshes/best/t_{t:.3f}.obj" for t in (0.0, 0.25, 0.5, 0.75, 1.0)}
WRITTEN = {
    "checkpoints/last.ckpt",
    "checkpoints/best.ckpt",
    "log/metrics.csv",
    "strip.png",
    "summary.json",
    "volume.csv",
    "volume.png",
    "volume_history.csv",
    *MESHES,
}


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setenv("NSM_CACHE_DIR", str(folder))
        yield folder


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """A run as a user starts it, and what it said."""
    folder = tmp_path_factory.mktemp("morph") / "run"
    command = [sys.executable, "-m", "nsm.train", *DISK, f"hydra.run.dir={folder}"]
    environment = {key: value for key, value in os.environ.items() if key != "NSM_DATA_DIR"}
    return folder, subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


def test_a_run_writes_everything_it_promises_and_says_where(finished: tuple) -> None:
    folder, process = finished
    assert process.returncode == 0, process.stderr
    assert files(folder) == WRITTEN
    assert all((folder / name).stat().st_size > 0 for name in WRITTEN)


def test_the_printed_summary_is_short_and_names_three_files(finished: tuple) -> None:
    folder, process = finished
    lines = process.stdout.splitlines()
    begin = next(index for index, line in enumerate(lines) if line.startswith("Finished: 12 steps in "))
    figures, place, names = lines[begin + 1 :]
    assert figures.startswith("  error ")
    assert place == f"Files in {folder}"
    assert names.split() == ["checkpoints/best.ckpt", "strip.png", "summary.json"]
    assert max(map(len, (lines[begin], figures, names))) <= 80
    assert "No shapes were given" not in process.stdout


def test_without_a_terminal_lines_tell_how_far_training_is(finished: tuple) -> None:
    last = finished[1].stderr.splitlines()[-1]
    assert re.match(r"training: 12 of 12 steps, .* elapsed, loss [\d.e+]+; validation at step 12: error [\d.]+", last)


def test_a_run_warns_of_nothing_but_its_own_roughness(finished: tuple) -> None:
    said = finished[1].stdout + finished[1].stderr
    assert said.count("warning: ") == said.count("differs from that of its end shapes") == 1
    said = "".join(line for line in said.splitlines() if "differs from that of its end shapes" not in line)
    assert "Warning" not in said
    assert "warn" not in said.lower().replace("warmup", "")
    assert "is deprecated" not in said
    assert "weights_only" not in said


def test_the_summary_holds_the_figures_of_the_best_validation(finished: tuple) -> None:
    summary = json.loads((finished[0] / "summary.json").read_text())
    assert summary["steps"] == 12
    assert summary["val/distance"] > 0
    parts = ("val/distance", "val/drift", "val/leftover")
    assert summary["val/error"] == pytest.approx(sum(summary[part] for part in parts))
    both_ways = (summary["val/shape_to_morph"] + summary["val/morph_to_shape"]) / 2
    assert summary["val/distance"] == pytest.approx(both_ways)
    best = torch.load(finished[0] / "checkpoints" / "best.ckpt", weights_only=True)
    assert summary["best_step"] == best["global_step"]
    with (finished[0] / "volume.csv").open() as file:
        volumes = [float(row["volume"]) for row in csv.DictReader(file)]
    assert len(volumes) == 3
    assert max(abs(v / volumes[0] - 1) for v in volumes) == pytest.approx(summary["val/volume_max"], rel=1e-4)


def test_the_log_has_every_term_at_every_step(finished: tuple) -> None:
    with (finished[0] / "log" / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    losses = [row for row in rows if row["train/loss"]]
    assert [int(row["step"]) for row in losses] == list(range(12))
    terms = [f"train/{name}" for name in ("level_set", "dirichlet", "surface", "volume", "neumann", "eikonal")]
    for row in losses:
        assert float(row["train/loss"]) == pytest.approx(sum(float(row[term]) for term in terms), rel=1e-4)
    assert sum(bool(row["val/error"]) for row in rows) == 2


@pytest.mark.parametrize("name", ["best", "last"])
def test_a_checkpoint_needs_nothing_but_itself(
    name: str, finished: tuple, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved = tmp_path / "moved.ckpt"
    moved.write_bytes((finished[0] / "checkpoints" / f"{name}.ckpt").read_bytes())
    monkeypatch.delenv("NSM_DATA_DIR", raising=False)
    monkeypatch.setenv("NSM_CACHE_DIR", str(tmp_path / "empty"))
    monkeypatch.chdir(tmp_path)
    morph = load_morph(moved)
    assert isinstance(morph, Morph)
    x = torch.rand(9, 2) * 2 - 1
    # two disks of radius 0.3 at ∓0.5, whose longest half side together is 0.8, placed so that it is 0.9
    torch.testing.assert_close(morph.source(x), (x - torch.tensor([-0.5625, 0.0])).norm(dim=1) - 0.3375)
    torch.testing.assert_close(morph.target(x), (x - torch.tensor([0.5625, 0.0])).norm(dim=1) - 0.3375)
    assert (morph(x, 0.5) * morph.source(x)).sum() > 0


def test_a_loaded_morph_is_bitwise_that_of_training(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trained: list[NeuralMorph] = []
    made = NeuralMorph.__init__

    def remember(self: NeuralMorph, *args: object, **more: object) -> None:
        made(self, *args, **more)
        trained.append(self)

    monkeypatch.setattr(NeuralMorph, "__init__", remember)
    assert train_here(*BARE, f"hydra.run.dir={tmp_path}") == 0
    (during,) = trained
    morph, x, t = load_morph(tmp_path / "checkpoints" / "last.ckpt"), torch.rand(50, 2) * 2 - 1, torch.rand(50)
    assert torch.equal(morph(x, t), during(x, t))
    assert torch.equal(morph.gradient(x, t), during.gradient(x, t))
    velocity, expected = morph.velocity(x, t), during.velocity(x, t)
    assert velocity is not None
    assert expected is not None
    assert torch.equal(velocity, expected)
    assert torch.equal(morph.source(x), during.source(x))
    assert torch.equal(morph.target(x), during.target(x))


def test_a_checkpoint_carries_its_configuration_and_the_origin_of_its_shapes(finished: tuple) -> None:
    entry = torch.load(finished[0] / "checkpoints" / "last.ckpt", weights_only=True)["nsm"]
    assert entry["config"]["steps"] == 12
    assert entry["config"]["name"] == "disk_translation"
    assert set(entry["provenance"]) == {"source", "target", "between"}
    assert entry["provenance"]["source"]["scale"] == pytest.approx(1)
    assert entry["model"]["field"]["omega"] == 8


@pytest.fixture(scope="module")
def mesh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball of 80 triangles, with a corner."""
    path = tmp_path_factory.mktemp("mesh") / "ball.obj"
    trimesh.creation.icosphere(1).export(path)
    return path


def test_one_shape_alone_becomes_a_network_that_serves_as_an_end_of_a_morph(
    mesh: Path, tmp_path: Path, cache: Path
) -> None:
    folder = tmp_path / "run"
    source = ("shape@source=mesh", f"source.path={mesh}", "~source.pose.translation", "~source.pose.rotation")
    still = [o for o in STILL if not o.startswith("+experiment")]
    assert train_here(*still, *source, f"hydra.run.dir={folder}") == 0
    assert files(folder) == {"checkpoints/last.ckpt", "checkpoints/best.ckpt", "log/metrics.csv", "summary.json"}
    assert json.loads((folder / "summary.json").read_text())["val/error"] < 0.3

    bare = [o for o in (*TINY, "callbacks=none", "optimizer.lr=1e-5") if not o.startswith("callbacks.")]
    ends = ("shape@source=fitted", f"source.path={folder}", "shape@target=ball", "source.pose.translation=[0.1,0,0]")
    morph = tmp_path / "morph"
    assert train_here(*bare, *ends, "steps=1", "validations=1", f"hydra.run.dir={morph}") == 0
    shape, loaded = load_shape(folder), load_morph(morph)
    entry = torch.load(morph / "checkpoints" / "last.ckpt", weights_only=True)["nsm"]
    # what took the shape from where it was fitted to where the pair was placed
    placed = Similarity.read(entry["provenance"]["source"]["similarity"], 3).after(shape.similarity.inverse())
    x = torch.rand(20, 3) - 0.5
    torch.testing.assert_close(loaded.source(x), placed.scale * shape(placed.pull_back(x)), rtol=1e-4, atol=1e-5)


def test_a_mesh_becomes_a_network_in_the_same_command_once(
    mesh: Path, tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted = []
    prepare = SdfFit.prepare
    monkeypatch.setattr(SdfFit, "prepare", lambda self, shape: fitted.append(shape) or prepare(self, shape))
    bare = [o for o in (*TINY, "callbacks=none", "optimizer.lr=1e-5") if not o.startswith("callbacks.")]
    run = (*bare, "shape@source=mesh", f"source.path={mesh}", "shape@target=ball", "steps=2", "validations=1")
    weights = []
    for name in ("first", "second"):
        assert train_here(*run, f"hydra.run.dir={tmp_path / name}") == 0
        weights.append(torch.load(tmp_path / name / "checkpoints" / "last.ckpt", weights_only=True)["state_dict"])
        assert len(fitted) == 1
    assert all(torch.equal(weights[0][key], weights[1][key]) for key in weights[0])
    assert train_here(*run, "sdf.steps=5", f"hydra.run.dir={tmp_path / 'third'}") == 0
    assert len(fitted) == 2


def test_the_cache_takes_the_content_of_a_mesh_for_its_name(
    mesh: Path, tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted = []
    prepare = SdfFit.prepare
    monkeypatch.setattr(SdfFit, "prepare", lambda self, shape: fitted.append(shape) or prepare(self, shape))
    monkeypatch.setenv("NSM_CACHE_DIR", str(tmp_path / "cache"))
    path = tmp_path / "a.obj"
    bare = [o for o in (*TINY, "callbacks=none", "optimizer.lr=1e-5") if not o.startswith("callbacks.")]
    run = (*bare, "shape@source=mesh", "shape@target=ball", "steps=1", "validations=1", "sdf.steps=60")
    for subdivisions in (1, 2):
        trimesh.creation.icosphere(subdivisions).export(path)
        assert train_here(*run, f"source.path={path}", f"hydra.run.dir={tmp_path / str(subdivisions)}") == 0
    assert len(fitted) == 2
    copy = tmp_path / "b.obj"
    copy.write_bytes(path.read_bytes())
    assert train_here(*run, f"source.path={copy}", f"hydra.run.dir={tmp_path / 'copy'}") == 0
    assert len(fitted) == 2


def test_everything_at_the_end_of_a_run_is_of_the_best_checkpoint(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run whose first validation is made its best: strip, meshes, summary and curve show that one, not the last."""
    honest = MorphTask.log_dict

    def worse_and_worse(self: MorphTask, figures: dict, **more: object) -> None:
        wrong = {"val/error": float(self.global_step)} if "val/error" in figures else {}
        honest(self, {**figures, **wrong}, **more)

    drawn = []
    monkeypatch.setattr(MorphTask, "log_dict", worse_and_worse)
    monkeypatch.setattr(callbacks.strip, "try_strip", lambda file, morph, *rest, **more: bool(drawn.append(morph)))
    run = (*DISK, "optimizer.lr=1e-2", "callbacks.meshes.times=[0.5]")
    assert train_here(*run, f"hydra.run.dir={tmp_path}") == 0
    assert "; best at step 6" in capsys.readouterr().out
    best, last = (load_morph(tmp_path / "checkpoints" / f"{name}.ckpt") for name in ("best", "last"))
    x = torch.rand(20, 2) - 0.5
    assert not torch.equal(best(x, 0.5), last(x, 0.5))
    assert torch.equal(drawn[0](x, 0.5), best(x, 0.5))

    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["steps"], summary["best_step"], summary["val/error"]) == (12, 6, 6.0)
    with (tmp_path / "volume_history.csv").open() as file:
        history = [(int(row["step"]), float(row["volume"])) for row in csv.DictReader(file)]
    with (tmp_path / "volume.csv").open() as file:
        shown = [float(row["volume"]) for row in csv.DictReader(file)]
    assert shown == pytest.approx([volume for step, volume in history if step == 6], rel=1e-6)
    lines = (tmp_path / "meshes/best/t_0.500.obj").read_text().splitlines()
    points = torch.tensor([[float(v) for v in line.split()[1:3]] for line in lines if line.startswith("v ")])
    assert best(points, 0.5).abs().mean() < 0.3 * last(points, 0.5).abs().mean()


def test_a_checkpoint_carries_the_box_of_the_moving_shape(finished: tuple) -> None:
    """The disk moves along x, so its box is wide and low, and it holds both ends."""
    low, high = load_morph(finished[0]).bounds.tolist()
    assert low[0] <= -0.8 + 1e-6
    assert high[0] >= 0.8 - 1e-6
    assert [low, high] != [[-1.0, -1.0], [1.0, 1.0]]
    assert min(low) >= -1.5
    assert max(high) <= 1.5


def test_training_moves_f_towards_its_ends(tmp_path: Path, cache: Path) -> None:
    """A little more than nothing: a short run brings f nearer to the end shapes than it began."""
    run = (*BARE, "steps=150", "validations=3", "optimizer.lr=3e-3", f"hydra.run.dir={tmp_path}")
    assert train_here(*run) == 0
    with (tmp_path / "log" / "metrics.csv").open() as file:
        losses = np.array([float(row["train/loss"]) for row in csv.DictReader(file) if row["train/loss"]])
    assert losses[-10:].mean() < 0.3 * losses[:3].mean()
