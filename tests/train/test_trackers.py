"""What trackers get of a run, decoded from the files that they wrote without a network."""

from __future__ import annotations

import base64
import csv
import hashlib
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from time import monotonic, sleep
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
import trimesh
import wandb
from analytic import sentence
from omegaconf import OmegaConf
from runs import BARE, TINY, train_here
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.util.tensor_util import make_ndarray
from wandb.proto import wandb_internal_pb2

#: A ball that stays where it is, in space. Few pictures: rendering takes most of the time.
BALL = (
    *TINY,
    "shape@source=ball",
    "shape@target=ball",
    "optimizer.lr=1e-5",
    "steps=2",
    "validations=1",
    "callbacks.meshes.times=[0,1]",
    "callbacks.strip.times=[0]",
)
#: A disk that stays near where it is, by optimal transport of few points.
TRANSPORT = (
    "method=ot",
    "+experiment=disk_translation",
    *(f"task.transport.{o}" for o in ("points=2000", "anchors=200", "blur=0.1", "kernel=0.08", "resolution=32")),
    "task.volume_resolution=32",
    "task.volume_times=3",
    "callbacks.meshes.times=[0.5]",
    "callbacks.meshes.resolution=12",
    "callbacks.strip.times=[0.5]",
    "callbacks.strip.size=24",
    "threads=1",
)
OFFLINE = ("logger=wandb", "logger.wandb.offline=true")
#: Both trackers.
BOTH = (
    *OFFLINE,
    "+logger.tensorboard._target_=nsm.train.callbacks.TensorBoardLog",
    "+logger.tensorboard.save_dir=${hydra:runtime.output_dir}",
    "+logger.tensorboard.name=''",
    "+logger.tensorboard.version=tensorboard",
)
#: Times of the meshes of the ball.
TIMES = ("0.000", "1.000")


@pytest.fixture(autouse=True, scope="module")
def surroundings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NSM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        for kind in ("DATA", "CACHE", "CONFIG"):
            patch.setenv(f"WANDB_{kind}_DIR", str(tmp_path_factory.mktemp("wandb")))
        patch.setenv("WANDB_SILENT", "true")
        patch.setenv("WANDB_BASE_URL", "http://127.0.0.1:9")  # nobody answers there
        patch.delenv("WANDB_API_KEY", raising=False)
        patch.delenv("WANDB_MODE", raising=False)
        yield


class Written(NamedTuple):
    """What is in an offline run of wandb."""

    files: Path
    run: Any
    config: dict[str, Any]
    history: list[dict[str, Any]]
    summary: dict[str, Any]
    artifacts: dict[str, Any]
    status: int

    def values(self, name: str) -> list[Any]:
        return [row[name] for row in self.history if name in row]

    def file(self, name: str) -> Path:
        """The last media file of that name."""
        last = self.values(name)[-1]
        return self.files / (last["path"] if "path" in last else last["filenames"][0])


def records(file: Path) -> Iterator[Any]:
    """The records of a .wandb file: a log of LevelDB, blocks of 32 KiB that hold a header and a part of a record."""
    data, place, parts = file.read_bytes(), 7, b""
    while place + 7 <= len(data):
        left = (1 << 15) - place % (1 << 15)
        if left < 7:
            place += left
            continue
        _, size, kind = struct.unpack("<IHB", data[place : place + 7])
        if place + 7 + size > len(data):
            break  # not written yet
        parts += data[place + 7 : place + 7 + size]
        place += 7 + size
        if kind in (1, 4):  # whole, or the last part
            record = wandb_internal_pb2.Record()
            record.ParseFromString(parts)
            parts = b""
            yield record


def nested(items: Any, into: dict[str, Any]) -> dict[str, Any]:
    for item in items:
        *above, last = list(item.nested_key) or [item.key]
        place = into
        for name in above:
            place = place.setdefault(name, {})
        place[last] = json.loads(item.value_json)
    return into


def complete(file: Path) -> list[Any]:
    """The records of a run that has ended; wandb writes them from a process of its own, and may take a moment more."""
    deadline = monotonic() + 60
    found = list(records(file))
    while not any(record.WhichOneof("record_type") == "exit" for record in found):
        assert monotonic() < deadline
        sleep(0.05)
        found = list(records(file))
    return found


def decoded(offline: Path) -> Written:
    (file,) = offline.glob("*.wandb")
    found = Written(offline / "files", [], {}, [], {}, {}, 0)
    for record in complete(file):
        kind = record.WhichOneof("record_type")
        if kind == "run":
            found.run.append(record.run)
            nested(record.run.config.update, found.config)
        elif kind == "config":
            nested(record.config.update, found.config)
        elif kind == "history":
            found.history.append(nested(record.history.item, {}))
        elif kind == "summary":
            nested(record.summary.update, found.summary)
        elif kind == "artifact":
            found.artifacts[record.artifact.type] = record.artifact
        elif kind == "exit":
            found = found._replace(status=record.exit.exit_code)
    del found.config["_wandb"]
    return found._replace(run=found.run[0])


def offline_runs(folder: Path) -> list[Written]:
    return [decoded(run) for run in sorted((folder / "wandb").glob("offline-run-*"))]


def configuration(folder: Path) -> dict[str, Any]:
    return torch.load(folder / "checkpoints" / "best.ckpt", weights_only=True)["nsm"]["config"]


def curve(folder: Path) -> list[list[float]]:
    with (folder / "volume.csv").open(newline="") as file:
        return [[float(value) for value in row.values()] for row in csv.DictReader(file)]


def best(folder: Path) -> dict[str, float]:
    figures = json.loads((folder / "summary.json").read_text())
    return {name.replace("val/", "best/"): value for name, value in figures.items() if name.startswith("val/")}


def same_surface(ours: Any, file: Path) -> None:
    """Two meshes have the same triangles, up to the order of their vertices."""
    theirs = trimesh.load(file, process=False)
    assert len(ours.faces) == len(theirs.faces) > 0
    np.testing.assert_allclose(ours.triangles, theirs.triangles, atol=1e-6)


def events(folder: Path) -> EventAccumulator:
    return EventAccumulator(str(folder / "tensorboard"), size_guidance={"tensors": 0}).Reload()


def text(found: EventAccumulator, name: str) -> str:
    return make_ndarray(found.Tensors(f"{name}/text_summary")[-1].tensor_proto).item().decode()


def tensor(found: EventAccumulator, name: str) -> np.ndarray:
    return make_ndarray(found.Tensors(name)[-1].tensor_proto)[0]


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory, surroundings: None) -> Path:
    """The folder of a finished run in space."""
    folder = tmp_path_factory.mktemp("ball")
    assert train_here(*BALL, *BOTH, "logger.wandb.tags=[ball,still]", f"hydra.run.dir={folder}") == 0
    assert wandb.run is None, "a next run would go on in this one"
    return folder


@pytest.fixture(scope="module")
def transport(tmp_path_factory: pytest.TempPathFactory, surroundings: None) -> Path:
    """The folder of a finished run of optimal transport in the plane."""
    folder = tmp_path_factory.mktemp("transport")
    assert train_here(*TRANSPORT, *BOTH, f"hydra.run.dir={folder}") == 0
    return folder


def test_wandb_gets_the_configuration_curves_meshes_and_checkpoint(ball: Path) -> None:
    (run,) = offline_runs(ball)
    assert run.config == configuration(ball)
    assert (run.run.display_name, list(run.run.tags), run.run.run_group) == ("ball_ball", ["ball", "still"], "")
    assert run.status == 0

    errors = [(row["trainer/global_step"], row["val/error"]) for row in run.history if "val/error" in row]
    assert errors == [(1, best(ball)["best/error"])]
    table = json.loads(run.file("volume_curve").read_text())
    assert table["columns"] == ["time", "volume", "deviation"]
    np.testing.assert_allclose(table["data"], curve(ball), rtol=1e-8, atol=1e-8)
    assert run.file("volume").read_bytes() == (ball / "volume.png").read_bytes()
    assert run.file("strip").read_bytes() == (ball / "strip.png").read_bytes()
    for time in TIMES:
        surface = trimesh.load(run.file(f"mesh/t_{time}"), force="mesh", process=False)
        same_surface(surface, ball / "meshes" / "best" / f"t_{time}.ply")

    model, checkpoint = run.artifacts["model"], ball / "checkpoints" / "best.ckpt"
    (entry,) = model.manifest.contents
    assert model.name == f"model-{run.run.run_id}"
    assert (entry.path, entry.local_path) == ("best.ckpt", str(checkpoint))
    assert base64.b64decode(entry.digest) == hashlib.md5(checkpoint.read_bytes()).digest()
    assert best(ball).items() <= run.summary.items()
    assert json.loads(model.metadata) == best(ball)


def test_tensorboard_gets_the_configuration_curves_and_meshes(ball: Path) -> None:
    found = events(ball)
    assert {"train/eikonal", "val/error", "val/volume_max"} <= set(found.Tags()["scalars"])
    assert [event.step for event in found.Scalars("val/error")] == [1]
    assert set(found.Tags()["images"]) == {"volume", "strip"}
    assert OmegaConf.to_container(OmegaConf.create(text(found, "config"))) == configuration(ball)
    header, _, *rows = text(found, "volume_curve").splitlines()
    assert header == "| time | volume | deviation |"
    shown = [[float(value) for value in row.split("|")[1:4]] for row in rows]
    np.testing.assert_allclose(shown, curve(ball), rtol=1e-5, atol=1e-8)
    for time in TIMES:
        vertices, faces = (tensor(found, f"mesh/t_{time}_{part}") for part in ("VERTEX", "FACE"))
        surface = trimesh.Trimesh(vertices, faces, process=False)
        same_surface(surface, ball / "meshes" / "best" / f"t_{time}.ply")
    assert {name: found.Scalars(name)[-1].value for name in best(ball)} == pytest.approx(best(ball))
    assert {"_hparams_/experiment", "_hparams_/session_start_info"} <= set(found.summary_metadata)


def test_trackers_get_optimal_transport_too(transport: Path) -> None:
    (run,) = offline_runs(transport)
    assert run.config == configuration(transport)
    assert list(run.run.tags) == ["ot"]
    assert run.values("val/volume_max") == [best(transport)["best/volume_max"]]
    table = json.loads(run.file("volume_curve").read_text())
    np.testing.assert_allclose(table["data"], curve(transport), rtol=1e-8, atol=1e-8)
    assert run.file("strip").read_bytes() == (transport / "strip.png").read_bytes()
    assert run.file("shapes").is_file()
    assert run.artifacts["model"].manifest.contents[0].path == "best.ckpt"
    found = events(transport)
    assert set(found.Tags()["images"]) == {"volume", "strip", "shapes"}
    assert found.Scalars("val/volume_max")[0].value == pytest.approx(best(transport)["best/volume_max"])
    assert "volume_curve/text_summary" in found.Tags()["tensors"]


def test_a_resumed_run_continues_the_same_run(tmp_path: Path, at_step: Any) -> None:
    plane = (*BARE, "steps=4", *BOTH, f"hydra.run.dir={tmp_path}")

    def crash() -> None:
        raise OSError("the disk is on fire")

    at_step(3, crash)
    with pytest.raises(OSError, match="on fire"):
        train_here(*plane)
    assert [event.step for event in events(tmp_path).Scalars("train/loss")] == [0, 1, 2]
    assert train_here(*plane, "resume=true") == 0
    # TensorBoard forgets the step that was made twice
    assert [event.step for event in events(tmp_path).Scalars("train/loss")] == [0, 1, 2, 3]
    assert [event.step for event in events(tmp_path).Scalars("val/error")] == [1, 3]

    first, second = offline_runs(tmp_path)
    assert first.run.run_id == second.run.run_id == (tmp_path / "wandb" / "id").read_text().strip()
    assert (first.status, second.status) == (1, 0)
    assert "model" not in first.artifacts
    assert second.config == {**configuration(tmp_path), "resume": True}
    steps = [[row["trainer/global_step"] for row in run.history if "train/loss" in row] for run in (first, second)]
    assert steps == [[0, 1, 2], [2, 3]]


def test_a_run_begun_anew_is_another_one(tmp_path: Path) -> None:
    plane = (*BARE, "steps=1", "validations=1", *OFFLINE, f"hydra.run.dir={tmp_path}")
    assert train_here(*plane) == train_here(*plane) == 0
    assert len({run.run.run_id for run in offline_runs(tmp_path)}) == 2


def test_the_runs_of_a_sweep_are_a_group_of_runs(tmp_path: Path) -> None:
    sweep = tmp_path / "losses"
    assert train_here("-m", *BARE, "steps=1,2", "validations=1", *OFFLINE, f"hydra.sweep.dir={sweep}") == 0
    runs = [run for number in (0, 1) for run in offline_runs(sweep / str(number))]
    assert [run.run.run_group for run in runs] == ["losses", "losses"]
    assert len({run.run.run_id for run in runs}) == 2
    assert [run.config["steps"] for run in runs] == [1, 2]


def test_a_server_that_does_not_answer_is_told_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(**settings: Any) -> None:
        raise wandb.errors.CommError("Run initialization has timed out after 90.0 sec.")

    monkeypatch.setattr(wandb, "init", fail)
    assert train_here(*BARE, *OFFLINE, f"hydra.run.dir={tmp_path}") == 2
    said = sentence(capsys.readouterr().err)
    assert "`logger=wandb` must be logged in to a server that answers, got: Run initialization has timed out" in said
    assert "Try `wandb login`, or `logger.wandb.offline=true`" in said
