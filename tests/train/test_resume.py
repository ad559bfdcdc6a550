"""Training that is stopped or killed resumes to the same weights."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch
from runs import BARE, files, same, state, train_here
from torch import Tensor

from nsm.io.checkpoint import load_morph
from nsm.train.tasks import MorphTask, SdfTask

#: Validations, and with them checkpoints, after 8, 16 and 24 steps of 24.
RUN = (*BARE, "steps=24", "validations=3", "optimizer.precondition_frequency=3")
#: The same for another process, with time to be killed.
LONG = (*BARE, "steps=60", "validations=6")


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NSM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


def weights(folder: Path) -> dict[str, Tensor]:
    return torch.load(folder / "checkpoints" / "last.ckpt", weights_only=True)["state_dict"]


def through(folder: Path, *overrides: str) -> Path:
    assert train_here(*(overrides or RUN), f"hydra.run.dir={folder}") == 0
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, cache: None) -> Path:
    """A run that nothing disturbed."""
    return through(tmp_path_factory.mktemp("whole") / "run")


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "log" / "metrics.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_run_gives_the_same_weights_every_time(whole: Path, tmp_path: Path) -> None:
    again = through(tmp_path / "run")
    assert same(weights(again), weights(whole))
    assert same(state(again)["optimizer_states"], state(whole)["optimizer_states"])


@pytest.mark.parametrize(("number", "step"), [(signal.SIGINT, 3), (signal.SIGTERM, 11), (signal.SIGINT, 15)])
def test_a_signal_stops_between_two_steps_and_resuming_gives_the_weights_of_a_run_that_went_through(
    number: signal.Signals, step: int, whole: Path, tmp_path: Path, at_step: Any
) -> None:
    folder = tmp_path / "run"
    at_step(step, lambda: os.kill(os.getpid(), number))
    assert train_here(*RUN, f"hydra.run.dir={folder}") == 128 + number
    assert state(folder)["global_step"] == step + 1
    assert not (folder / "summary.json").exists()
    assert through(folder, *RUN, "resume=true")
    assert same(weights(folder), weights(whole))
    for part in ("optimizer_states", "lr_schedulers", "global_step"):
        assert same(state(folder)[part], state(whole)[part]), part
    # the last ones: a stop is validated as well, so the interrupted run has one more candidate for the best
    ends = [load_morph(run / "checkpoints" / "last.ckpt").state_dict() for run in (folder, whole)]
    assert same(*ends)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_a_shape_is_being_fitted_ends_the_command_and_leaves_nothing(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_step: Any
) -> None:
    monkeypatch.setenv("NSM_CACHE_DIR", str(tmp_path / "cache"))
    at_step(3, lambda: os.kill(os.getpid(), number), SdfTask)
    before = signal.getsignal(number)
    assert train_here(*RUN, f"hydra.run.dir={tmp_path / 'run'}") == 128 + number
    assert signal.getsignal(number) == before
    assert not files(tmp_path / "run")
    assert not files(tmp_path / "cache")


def test_signals_are_given_back(whole: Path, tmp_path: Path, at_step: Any) -> None:
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    at_step(2, lambda: os.kill(os.getpid(), signal.SIGTERM))
    train_here(*RUN, f"hydra.run.dir={tmp_path}")
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == before


def test_a_stop_waits_for_the_step_whose_gradients_are_being_gathered(tmp_path: Path, at_step: Any) -> None:
    run = (*RUN, "trainer.accumulate_grad_batches=2", "steps=8", "validations=1")
    reference = through(tmp_path / "whole", *run)
    folder = tmp_path / "run"
    at_step(3, lambda: os.kill(os.getpid(), signal.SIGTERM))
    assert train_here(*run, f"hydra.run.dir={folder}") == 143
    assert state(folder)["global_step"] == 4
    through(folder, *run, "resume=true")
    assert same(weights(folder), weights(reference))


def test_a_crash_leaves_the_last_validation_to_go_on_from(whole: Path, tmp_path: Path, at_step: Any) -> None:
    folder = tmp_path / "run"

    def crash() -> None:
        raise OSError("the disk is on fire")

    at_step(13, crash)
    with pytest.raises(OSError, match="on fire"):
        train_here(*RUN, f"hydra.run.dir={folder}")
    assert state(folder)["global_step"] == 8
    through(folder, *RUN, "resume=true")
    assert same(weights(folder), weights(whole))
    assert [r["step"] for r in rows(folder) if r["train/loss"]] == [str(i) for i in range(24)]


def test_the_last_checkpoint_is_that_of_the_last_validation_also_where_it_is_not_the_best(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_step: Any
) -> None:
    honest = MorphTask.log_dict

    def worse_and_worse(self: MorphTask, figures: dict[str, Any], **more: Any) -> None:
        wrong = {"val/error": float(self.global_step)} if "val/error" in figures else {}
        honest(self, {**figures, **wrong}, **more)

    monkeypatch.setattr(MorphTask, "log_dict", worse_and_worse)

    def crash() -> None:
        raise OSError("the disk is on fire")

    at_step(20, crash)
    with pytest.raises(OSError, match="on fire"):
        train_here(*RUN, f"hydra.run.dir={tmp_path}")
    assert state(tmp_path)["global_step"] == 16
    assert torch.load(tmp_path / "checkpoints" / "best.ckpt", weights_only=True)["global_step"] == 8


def test_a_resumed_run_keeps_what_was_logged(whole: Path, tmp_path: Path, at_step: Any) -> None:
    folder = tmp_path / "run"
    at_step(11, lambda: os.kill(os.getpid(), signal.SIGTERM))
    train_here(*RUN, f"hydra.run.dir={folder}")
    through(folder, *RUN, "resume=true")
    losses = [(r["step"], r["train/loss"]) for r in rows(folder) if r["train/loss"]]
    assert losses == [(r["step"], r["train/loss"]) for r in rows(whole) if r["train/loss"]]


def test_a_finished_run_has_nothing_left_to_do_and_loses_nothing(whole: Path, tmp_path: Path) -> None:
    folder = through(tmp_path / "run", *RUN, "steps=3", "validations=1")
    before = {p: p.read_bytes() for p in folder.rglob("*.*") if p.suffix in (".csv", ".json", ".png")}
    kept = weights(folder)
    through(folder, *RUN, "steps=3", "validations=1", "resume=true")
    assert {p: p.read_bytes() for p in before} == before
    assert same(weights(folder), kept)


def test_resuming_where_nothing_was_begun_begins(whole: Path, tmp_path: Path) -> None:
    through(tmp_path / "run", *RUN, "resume=true")
    assert same(weights(tmp_path / "run"), weights(whole))


def test_a_run_goes_on_only_as_it_began(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = weights(whole)
    changes = ["sampler.size=100", "velocity=free"]
    assert train_here(*RUN, *changes, f"hydra.run.dir={whole}", "resume=true") == 2
    said = capsys.readouterr().err.strip()
    assert "got another sampler.size, velocity._target_, velocity.beta. Try the command that started the run" in said
    assert "`resume=true` must repeat the settings of the run in" in said
    assert len(said.splitlines()) == 1
    assert same(weights(whole), kept)


def test_the_number_of_threads_may_change(tmp_path: Path) -> None:
    run = (*RUN, "steps=2", "validations=1")
    through(tmp_path / "run", *run)
    assert train_here(*run, "threads=2", "resume=true", f"hydra.run.dir={tmp_path / 'run'}") == 0
    torch.set_num_threads(1)


def begin(folder: Path) -> subprocess.Popen[str]:
    """Start a long run in a process of its own, and wait for its first checkpoint."""
    command = [sys.executable, "-m", "nsm.train", *LONG, f"hydra.run.dir={folder}"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    deadline = time.monotonic() + 120
    while not (folder / "checkpoints" / "last.ckpt").is_file():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.005)
    return process


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory, cache: None) -> Path:
    return through(tmp_path_factory.mktemp("long") / "run", *LONG)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_process_that_is_stopped_or_killed_can_go_on(number: signal.Signals, long: Path, tmp_path: Path) -> None:
    process = begin(tmp_path)
    process.send_signal(number)
    _, said = process.communicate(timeout=60)
    assert process.returncode == (-9 if number == signal.SIGKILL else 128 + number)
    assert "Traceback" not in said
    assert 0 < state(tmp_path)["global_step"] < 60
    through(tmp_path, *LONG, "resume=true")
    assert same(weights(tmp_path), weights(long))
