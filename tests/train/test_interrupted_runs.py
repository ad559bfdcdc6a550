"""A run that was killed loses nothing: it finishes when it is resumed, from whichever checkpoint can be read."""

from __future__ import annotations

import csv
import json
import os
import signal
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import lightning as L
import pytest
import torch
from runs import BARE, DISK, files, train_here

from nsm.cli.errors import InputError
from nsm.cli.locks import only_writer_of_folder
from nsm.io.checkpoint import find_checkpoint, load_morph
from nsm.train.callbacks import CsvLog, StopOnSignal, Strip
from nsm.train.checkpoint_files import WholeCheckpoints

#: Validations, and with them checkpoints, after 4, 8, and 12 steps.
RUN = (*DISK, "steps=12", "validations=3", "callbacks.meshes.every=2")


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NSM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory, cache: None) -> Path:
    """A run that ended without a word after its last validation, before its strip was drawn."""

    def end(*_: Any) -> None:
        raise SystemExit(9)

    folder = tmp_path_factory.mktemp("killed") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Strip, "on_train_end", end)
        patch.setattr(tempfile, "tempdir", "/nowhere")  # checkpoints must not pass through the temporary folder
        assert train_here(*RUN, f"hydra.run.dir={folder}") == 9
    assert not {"strip.png", "summary.json"} & files(folder)
    return folder


def test_a_run_that_was_killed_after_its_last_validation_gets_its_summary_and_strip(
    killed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = killed / "log" / "metrics.csv"
    whole = table.read_text()
    table.write_text(whole[:-3])
    last = killed / "checkpoints" / "last.ckpt"
    before = last.read_bytes()
    assert train_here(*RUN, f"hydra.run.dir={killed}", "resume=true") == 0
    assert {"strip.png", "summary.json", "meshes/best/t_0.500.obj"} <= files(killed)
    summary = json.loads((killed / "summary.json").read_text())
    best = torch.load(killed / "checkpoints" / "best.ckpt", weights_only=True)
    assert summary["steps"] == 12
    assert summary["best_step"] == best["global_step"]
    assert summary["training_s"] > 0
    assert "val/error" in summary
    assert last.read_bytes() == before
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert all(None not in row.values() and None not in row for row in rows)
    assert len(rows) == whole.count("\n") - 2  # all but the heading and the row that was cut

    assert train_here(*RUN, f"hydra.run.dir={killed}", "resume=true") == 0
    assert "already finished its 12 steps" in capsys.readouterr().out


def test_a_checkpoint_that_was_cut_is_replaced_by_the_other_one(
    killed: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for name in ("last", "best"):
        (tmp_path / "checkpoints").mkdir(exist_ok=True)
        (tmp_path / "checkpoints" / f"{name}.ckpt").write_bytes((killed / "checkpoints" / f"{name}.ckpt").read_bytes())
    best, last = (tmp_path / "checkpoints" / f"{name}.ckpt" for name in ("best", "last"))
    assert find_checkpoint(tmp_path) == best
    assert not caplog.text
    best.write_bytes(best.read_bytes()[:1000])
    assert find_checkpoint(tmp_path) == last
    assert load_morph(tmp_path).dim == 2
    assert f"best.ckpt in {best.parent} cannot be read, so last.ckpt is used" in caplog.text
    last.write_bytes(b"")
    with pytest.raises(InputError, match=r"best\.ckpt` must be a complete checkpoint"):
        find_checkpoint(tmp_path)


def test_a_run_resumes_from_the_best_checkpoint_where_the_last_was_cut(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = (*BARE, "steps=4", "validations=2", f"hydra.run.dir={tmp_path}")
    assert train_here(*run) == 0
    last, best = (tmp_path / "checkpoints" / f"{name}.ckpt" for name in ("last", "best"))
    wanted = torch.load(last, weights_only=True)["state_dict"]
    state = torch.load(best, weights_only=True)
    checkpoints = next(value for key, value in state["callbacks"].items() if key.startswith("Checkpoints"))
    assert checkpoints["best_step"] == state["global_step"]
    last.write_bytes(last.read_bytes()[:-500])
    (tmp_path / "summary.json").unlink()
    assert train_here(*run, "resume=true") == 0
    assert f"last.ckpt in {last.parent} cannot be read, so best.ckpt is used" in capsys.readouterr().out
    assert (tmp_path / "summary.json").is_file()
    found = torch.load(last if last.is_file() else best, weights_only=True)["state_dict"]
    assert all(torch.equal(found[name], wanted[name]) for name in wanted)


def test_snapshots_of_a_resumed_run_are_of_the_same_steps(tmp_path: Path, at_step: Any) -> None:
    meshes = ("+callbacks.meshes._target_=nsm.train.callbacks.MeshSnapshots", f"+callbacks.meshes.folder={tmp_path}")
    few = ("+callbacks.meshes.times=[0.5]", "+callbacks.meshes.resolution=8", "+callbacks.meshes.every=2")
    run = (*BARE, "steps=8", "validations=4", *meshes, *few, f"hydra.run.dir={tmp_path}")
    at_step(2, lambda: os.kill(os.getpid(), signal.SIGTERM))  # validated after step 3, beside those after 2, 4, 6, 8
    assert train_here(*run) == 143
    assert train_here(*run, "resume=true") == 0
    assert sorted(path.name for path in (tmp_path / "meshes").iterdir()) == ["best", "step_000004", "step_000008"]


def test_a_second_process_in_the_folder_of_a_run_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("nsm.cli.locks._PATIENCE", 0.1)
    with only_writer_of_folder(tmp_path):
        assert train_here(*RUN, f"hydra.run.dir={tmp_path}") == 2
    said = capsys.readouterr().err.strip()
    assert f"`{tmp_path}` must be written by one command at a time" in said
    assert len(said.splitlines()) == 1


def test_an_unwritable_cache_is_blamed_with_its_setting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("NSM_CACHE_DIR", str(tmp_path / "file"))
    assert train_here(*RUN, f"hydra.run.dir={tmp_path / 'run'}") == 2
    said = capsys.readouterr().err
    assert "`NSM_CACHE_DIR` must name a folder that can be written" in said
    assert "hydra.run.dir" not in said


def test_a_damaged_fit_in_the_cache_is_made_again_with_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NSM_CACHE_DIR", str(tmp_path / "cache"))
    run = (*BARE, "steps=1", "validations=1", "sdf.steps=5", f"hydra.run.dir={tmp_path / 'run'}")
    assert train_here(*run) == 0
    file = next((tmp_path / "cache" / "sdf").glob("*.ckpt"))
    whole = torch.load(file, weights_only=True)
    spoiled = {name: torch.full_like(value, float("nan")) for name, value in whole["state_dict"].items()}
    torch.save(whole | {"state_dict": spoiled}, file)
    assert train_here(*run) == 0
    assert "is made again" in capsys.readouterr().out
    again = torch.load(file, weights_only=True)["state_dict"]
    assert all(torch.equal(again[name], value) for name, value in whole["state_dict"].items())


def test_rows_of_a_table_that_was_cut_are_dropped(tmp_path: Path) -> None:
    file = tmp_path / "log" / "metrics.csv"
    file.parent.mkdir()
    file.write_text("epoch,step,train/loss\r\n0,0,3.0\r\n0,1,\r\n0,2\r\n0,3,2.\0\r\nx,y,z\r\n0,4,1.23")
    log = CsvLog(str(tmp_path), name="", version="log")
    log.log_metrics({"epoch": 0, "train/loss": 1.0}, 4)
    log.finalize("success")
    with file.open(newline="") as lines:
        assert [(row["step"], row["train/loss"]) for row in csv.DictReader(lines)] == [
            ("0", "3.0"), ("1", ""), ("3", "2."), ("4", "1.0"),
        ]  # fmt: skip


def of_two_processes(reduce: Callable[..., torch.Tensor], batches: int) -> tuple[mock.Mock, mock.Mock]:
    """A trainer with as many batches per step in one of two processes, and its module."""
    trainer, module = mock.Mock(spec=L.Trainer), mock.Mock(spec=L.LightningModule)
    trainer.world_size, trainer.accumulate_grad_batches, trainer.should_stop = 2, batches, False
    trainer.strategy = SimpleNamespace(root_device="cpu", reduce=reduce)
    return trainer, module


def stops_after_the_second_batch(stop: StopOnSignal, trainer: mock.Mock, module: mock.Mock) -> None:
    stop.on_train_batch_end(trainer, module, None, None, 0)
    assert not trainer.should_stop
    stop.on_train_batch_end(trainer, module, None, None, 1)
    assert trainer.should_stop
    assert stop.received == signal.SIGTERM


def test_a_signal_to_one_of_several_processes_stops_them_all_after_the_same_step() -> None:
    numbers: list[float] = []

    def reduce(number: torch.Tensor, reduce_op: str) -> torch.Tensor:
        """The greatest number of all processes, another one of which has received SIGTERM."""
        numbers.append(float(number))
        return torch.maximum(number, torch.tensor(float(signal.SIGTERM)))

    stop = StopOnSignal()
    stops_after_the_second_batch(stop, *of_two_processes(reduce, batches=2))
    assert numbers == [0.0]


def test_a_signal_during_the_exchange_between_processes_counts_at_the_next_step() -> None:
    def reduce(number: torch.Tensor, reduce_op: str) -> torch.Tensor:
        stop.receive(signal.SIGTERM)  # after this process has told the others of none
        return number

    stop = StopOnSignal()
    stops_after_the_second_batch(stop, *of_two_processes(reduce, batches=1))


def test_a_checkpoint_is_replaced_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "last.ckpt"
    WholeCheckpoints().save_checkpoint({"step": 1}, file)

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match=r"last.ckpt` must fit on its disk, got: No space left on device"):
        WholeCheckpoints().save_checkpoint({"step": 2}, file)
    assert torch.load(file, weights_only=True) == {"step": 1}
    assert list(tmp_path.iterdir()) == [file]
