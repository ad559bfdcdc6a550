"""Runs of a study: how many steps they make, how they fail, and how they resume."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from unittest import mock

import lightning as L
import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from studies import TINY, compare_here, rows, tiny

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.compare import run
from nsm.compare.measurement import Measurement
from nsm.compare.plan import Budget, Job
from nsm.compare.progress import measuring_progress, training_progress
from nsm.compare.record import FAILED, INTERRUPTED, being_carried_out, prepare, read_record, write_record
from nsm.metrics import Protocol
from nsm.train.callbacks import StepTimes


def test_without_a_budget_a_run_makes_the_steps_of_its_recipe(tmp_path: Path, started: list[Path]) -> None:
    job = Job("disk", "adadiv", 0, ("+experiment=disk_translation", "method=adadiv", *TINY, "steps=4"), tmp_path / "r")
    record = prepare(job, Budget(None, None), trained=True, threads=1, retry=False)
    assert record.steps is None
    assert run.carry_out({"folder": str(job.folder)}) == "done"
    assert started == [job.folder], "nothing is measured first"
    assert read_record(job.folder).steps == 4  # type: ignore[union-attr]
    assert prepare(job, Budget(None, None), True, 1, retry=False).state == "done"


def test_minutes_become_steps_by_the_time_of_one_and_stay_what_they_were(tmp_path: Path, started: list[Path]) -> None:
    job = Job("disk", "adadiv", 0, ("+experiment=disk_translation", "method=adadiv", *TINY, "seed=0"), tmp_path / "r")
    prepare(job, Budget(0.01, None), trained=True, threads=1, retry=False)
    assert run.carry_out({"folder": str(job.folder)}) == "done"
    record = read_record(job.folder)
    assert record is not None
    assert record.step_s is not None
    allowed = 0.6 / record.step_s
    assert record.steps is not None
    assert 0.9 * allowed <= record.steps <= max(1.0, allowed)
    assert started == [job.folder, job.folder]  # once to measure, once to train
    assert not (job.folder / "timing").exists()
    assert json.loads((job.folder / "summary.json").read_text())["steps"] == record.steps
    assert prepare(job, Budget(0.01, None), trained=True, threads=1, retry=True).steps == record.steps


@pytest.mark.parametrize(
    ("status", "said", "state", "reason"),
    [
        (2, "nsm: training collapsed twice\n", FAILED, "training collapsed twice"),
        (1, "Traceback (most recent call last):\nRuntimeError: no memory\n", FAILED, "RuntimeError: no memory"),
        (1, "", FAILED, "it ended with status 1 and without a summary"),
        (0, "", FAILED, "it ended with status 0 and without a summary"),
        (-signal.SIGKILL, "", INTERRUPTED, "its process was ended by SIGKILL, possibly because memory ran out"),
        (128 + signal.SIGTERM, "stopped", INTERRUPTED, "its process was ended by SIGTERM"),
    ],
)
def test_why_a_run_failed_is_kept(
    status: int, said: str, state: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(arguments: Sequence[str], log: Path, threads: int | None) -> int:
        log.write_text(said)
        return status

    monkeypatch.setattr(run, "_start", fail)
    job = Job("disk", "free", 0, ("method=free",), tmp_path / "run")
    budget = Budget(None, 3)
    prepare(job, budget, trained=True, threads=None, retry=False)
    assert run.carry_out({"folder": str(job.folder)}) == state
    assert read_record(job.folder).reason == reason  # type: ignore[union-attr]
    # what failed is not tried again unless asked for, what was ended from outside is
    assert prepare(job, budget, True, None, retry=False).state == (FAILED if state == FAILED else "planned")
    assert prepare(job, budget, True, None, retry=True).state == "planned"


def test_runs_are_a_group_of_wandb_named_after_the_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loggers = []

    def note(arguments: Sequence[str], log: Path, threads: int | None) -> int:
        with initialize_config_dir(str(CONF), version_base="1.3"):
            loggers.append(compose("train", list(arguments)).logger)
        folder = Path(next(a for a in arguments if a.startswith("hydra.run.dir=")).partition("=")[2].strip("'"))
        folder.mkdir(exist_ok=True)
        (folder / "step_times.json").write_text('{"step_s": 0.1}')
        (folder / "summary.json").write_text('{"steps": 6}')
        return 0

    monkeypatch.setattr(run, "_start", note)
    folder = tmp_path / "my study" / "runs" / "disk" / "free" / "seed_3"
    chosen = ("+experiment=disk_translation", "method=free", "logger=wandb", "logger.wandb.offline=true")
    prepare(Job("disk", "free", 3, chosen, folder), Budget(0.01, None), trained=True, threads=None, retry=False)
    assert run.carry_out({"folder": str(folder)}) == "done"
    measured, trained = loggers
    assert list(measured) == ["csv"], "timing a step is no run"
    assert (trained.wandb.group, trained.wandb.offline) == ("my study", True)
    assert OmegaConf.to_container(trained.wandb, resolve=False)["name"] == "disk/free/seed_3"


def test_a_run_that_another_worker_carries_out_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = Job("disk", "free", 0, ("method=free",), tmp_path / "run")
    record = prepare(job, Budget(None, 3), trained=True, threads=None, retry=False)
    monkeypatch.setattr(run, "_start", mock.Mock(side_effect=AssertionError("run twice")))
    states: list[str] = []
    second = threading.Thread(target=lambda: states.append(run.carry_out({"folder": str(job.folder)})))
    with being_carried_out(job.folder):
        second.start()
        time.sleep(0.2)
        assert not states
        write_record(job.folder, record._replace(state="done"))
    second.join()
    assert states == ["done"]


def test_settings_may_change_until_a_run_has_begun(tmp_path: Path) -> None:
    job = Job("disk", "free", 0, ("method=free",), tmp_path / "run")
    prepare(job, Budget(None, 3), True, None, retry=False)
    assert prepare(job, Budget(None, 5), True, None, retry=False).steps == 5
    (job.folder / "checkpoints").mkdir()
    changed = job._replace(overrides=("method=nise",))
    with pytest.raises(InputError, match=r"begun with method=free \(now method=nise\)"):
        prepare(changed, Budget(None, 5), True, None, retry=False)


#: In place of training: ticks until it is interrupted, and says so.
TICKER = """
import sys, time
from pathlib import Path
folder = Path([a for a in sys.argv if a.startswith("hydra.run.dir=")][0].partition("=")[2].strip("'"))
try:
    while True:
        (folder / "tick").write_text(str(time.time()))
        time.sleep(0.01)
except KeyboardInterrupt:
    (folder / "stopped").touch()
    sys.exit(130)
"""


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Ctrl-C raises, as it does not in a process that a script began in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_lets_a_run_finish_its_step_and_the_study_stops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ticker.py").write_text(TICKER)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(run, "COMMAND", "ticker")
    job = Job("disk", "free", 0, ("method=free",), tmp_path / "run")
    budget = Budget(None, 3)
    prepare(job, budget, True, None, retry=False)

    def interrupt() -> None:
        wait_for((job.folder / "tick").is_file)
        time.sleep(1)  # a signal that comes before the main thread waits for the run would not wake it
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        run.carry_out({"folder": str(job.folder)})
    thread.join()
    assert (job.folder / "stopped").is_file()
    assert prepare(job, budget, True, None, retry=False).state == "planned"


def wait_for(what: Callable[[], bool], process: subprocess.Popen[str] | None = None) -> None:
    deadline = time.monotonic() + 120
    while not what():
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_study_that_is_killed_takes_its_run_along_and_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    often = ["validations=250" if o.startswith("validations") else o for o in TINY]
    study = (*tiny(tmp_path, "methods=[adadiv]", "steps=1000"), f"overrides={json.dumps(often)}")
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "nsm.compare", *study]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment)
    folder = tmp_path / "runs" / "disk_translation" / "adadiv"
    last = folder / "checkpoints" / "last.ckpt"
    wait_for(last.is_file, process)
    process.kill()
    process.communicate(timeout=60)
    time.sleep(0.3)
    kept = last.read_bytes()
    time.sleep(0.5)
    assert last.read_bytes() == kept  # nobody trains any more
    step = torch.load(last, weights_only=True)["global_step"]
    assert 0 < step < 1000
    record = read_record(folder)
    assert record is not None
    assert record.state == "training"

    steps: list[int] = []

    def resumed(arguments: Sequence[str], log: Path, threads: int | None) -> int:
        assert "resume=true" in arguments
        steps.append(step)
        # as a run ends that had no more to do
        (log.parent / "summary.json").write_text('{"steps": 1000, "training_s": 1.0}')
        return 0

    monkeypatch.setattr(run, "_start", resumed)
    assert compare_here(*study) == 0
    assert steps == [step]
    assert rows(tmp_path)["adadiv"]["reason"] is None


def test_training_time_adds_up_over_sessions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter([0.0, 1.0, 3.0, 10.0, 11.0, 12.0, 13.0])
    clock = mock.Mock(perf_counter=lambda: next(now))  # not that of the library of locks
    monkeypatch.setattr("nsm.train.callbacks.step_times.time", clock)
    first, second = StepTimes(str(tmp_path)), StepTimes(str(tmp_path))
    trainer, module = mock.Mock(spec=L.Trainer), mock.Mock(spec=L.LightningModule)
    first.on_train_start(trainer, module)
    first.on_train_batch_end(trainer, module, None, None, 0)
    kept = first.state_dict()
    assert kept == {"seconds": 3.0, "step_s": 1.0}
    second.load_state_dict(kept)
    second.on_train_start(trainer, module)
    second.on_train_batch_end(trainer, module, None, None, 0)
    second.on_train_batch_end(trainer, module, None, None, 0)
    second.on_train_end(trainer, module)
    assert json.loads((tmp_path / "step_times.json").read_text()) == {
        "training_s": 6.0,
        "step_s": 1.0,
    }


def test_progress_tells_finished_runs_from_active_ones(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    runs = [Job("disk", method, 0, (), tmp_path / method) for method in ("free", "nise", "adadiv")]
    for job, state in zip(runs, ("done", "training", "planned"), strict=True):
        record = prepare(job, Budget(None, 8), True, None, retry=False)
        write_record(job.folder, record._replace(state=state))
    log = runs[1].folder / "log" / "metrics.csv"
    log.parent.mkdir()
    log.write_text("epoch,step,train/loss\n0,3,1.0\n")
    with training_progress(runs):
        pass
    printed = capfd.readouterr().err
    assert printed.startswith("training: 1 of 3 runs, ")
    assert "disk/nise: step 4 of 8" in printed


def test_progress_tells_measured_morphs_from_those_being_measured(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    asked = [
        Measurement(f"disk/{name}", tmp_path / name, "a.ckpt", "network", "none", Protocol(), None) for name in "abc"
    ]
    for each in asked[1:]:
        each.request()
    request = asked[1].folder / "measure.json"
    request.write_text(json.dumps(json.loads(request.read_text()) | {"stage": "volume over time"}))
    with measuring_progress(asked):
        pass
    printed = capfd.readouterr().err
    assert printed.startswith("measuring: 1 of 3 morphs, ")
    assert printed.rstrip().endswith(", disk/b: volume over time")
    with measuring_progress([]):
        pass
    assert not capfd.readouterr().err, "nothing to measure is no work"
