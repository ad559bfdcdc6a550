"""One run of a study in a process of its own: its steps are timed where needed, then it is trained."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nsm.cli.child import MODULE
from nsm.cli.overrides import literal
from nsm.compare.record import (
    DONE,
    FAILED,
    INTERRUPTED,
    TIMING,
    TRAINING,
    Record,
    being_carried_out,
    read_record,
    write_record,
)

#: Steps in which the time of one step is measured; the steps of the warm-up do not count.
TIMED_STEPS = 40
#: Overrides of every run: the study draws the pictures, and the time of each step is recorded.
OVERRIDES = (
    "callbacks=none",
    "+callbacks.step_times._target_=nsm.train.callbacks.StepTimes",
    "+callbacks.step_times.folder=${hydra:runtime.output_dir}",
)
#: Further overrides while steps are timed: no checkpoints or validations, since some methods have no surface so early,
#: and a learning rate so small that the short schedule cannot make training diverge.
_TRIAL = (
    "~callbacks.checkpoints",
    "+callbacks.unvalidated._target_=nsm.train.callbacks.Unvalidated",
    "optimizer.lr=1e-6",
)
#: Module of the command that trains.
COMMAND = "nsm.train"
#: Seconds that a run may take to finish its step and save it when the study is stopped.
_PATIENCE = 120.0
#: Exit status of a process that a signal ended, minus the number of the signal, by the convention of shells.
_BY_SIGNAL = 128
#: Digits to which a number of steps is rounded down.
_DIGITS = 3


def carry_out(config: Mapping[str, Any]) -> str:
    """Carry out or resume the run in the folder ``config["folder"]``, as its ``run.json`` specifies.

    A failure of the run is recorded there and not raised. While another worker carries out the run, this one waits for
    it, and does nothing if the run is finished then.

    Args:
        config: Configuration of ``conf/compare_run.yaml``.

    Returns:
        The state of the run afterwards.

    Raises:
        FileNotFoundError: If the folder has no record.
    """
    folder = Path(config["folder"])
    with being_carried_out(folder):
        record = read_record(folder)
        if record is None:
            raise FileNotFoundError(f"{folder / 'run.json'} is missing; the study was moved while it ran")
        if record.state in (DONE, FAILED):
            return record.state
        if record.trained and record.steps is None and record.settings["minutes"] is not None:
            record = _timed(folder, record)
        if record.reason is None:
            record = _trained(folder, record)
        write_record(folder, record)
        return record.state


def _timed(folder: Path, record: Record) -> Record:
    """Find the number of steps that the minutes allow, by timing a few."""
    write_record(folder, record._replace(state=TIMING))
    trial = folder / "timing"
    shutil.rmtree(trial, ignore_errors=True)
    log = folder / "output.log"
    untracked = ["~logger.wandb"] if _labels(record, folder) else []
    status = _start([*_arguments(record, trial, TIMED_STEPS), *_TRIAL, *untracked], log, record.threads)
    if status:
        return _failed(record, status, log)
    timing = json.loads((trial / "step_times.json").read_text())
    shutil.rmtree(trial)
    steps = _rounded(max(1.0, 60 * record.settings["minutes"] / timing["step_s"]))
    return record._replace(steps=steps, step_s=timing["step_s"])


def _trained(folder: Path, record: Record) -> Record:
    write_record(folder, record._replace(state=TRAINING, reason=None))
    log = folder / "output.log"
    arguments = [*_labels(record, folder), *_arguments(record, folder, record.steps), "resume=true"]
    status = _start(arguments, log, record.threads)
    if status or not (folder / "summary.json").is_file():
        return _failed(record, status, log)
    made = json.loads((folder / "summary.json").read_text())["steps"]
    return record._replace(state=DONE, steps=made if record.trained else None)


def _labels(record: Record, folder: Path) -> list[str]:
    """Overrides that name the run in wandb after its place in the study, in the group of the study."""
    if "logger=wandb" not in record.settings["overrides"]:
        return []
    parts = folder.resolve().parts
    runs = len(parts) - 1 - parts[::-1].index("runs")
    return [
        f"logger.wandb.group={literal(parts[runs - 1])}",
        f"logger.wandb.name={literal('/'.join(parts[runs + 1 :]))}",
    ]


def _arguments(record: Record, folder: Path, steps: int | None) -> list[str]:
    path = str(folder.resolve()).replace("\\", "\\\\").replace("'", "\\'")
    return [
        *record.settings["overrides"],
        *OVERRIDES,
        *([f"steps={steps}"] if steps else []),
        *([f"threads={record.threads}"] if record.threads else []),
        f"hydra.run.dir='{path}'",
    ]


def _start(arguments: Sequence[str], log: Path, threads: int | None) -> int:
    """Train in another process and wait for it.

    Ctrl-C reaches this process alone, which lets the other one finish its step and save it.

    Returns:
        The exit status, negative for a signal.
    """
    environment = dict(os.environ) | ({"OMP_NUM_THREADS": str(threads)} if threads else {})
    command = [sys.executable, "-m", MODULE, COMMAND, *arguments]
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("w") as output:
        child = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,
        )
        with child:
            try:
                return child.wait()
            except BaseException:
                child.send_signal(signal.SIGINT)
                try:
                    child.wait(_PATIENCE)
                finally:
                    child.kill()
                raise


def _failed(record: Record, status: int, log: Path) -> Record:
    """Record a failure with the reason that the log or the exit status gives."""
    ended = -status if status < 0 else status - _BY_SIGNAL
    if ended in set(signal.Signals):
        name = signal.Signals(ended).name
        hint = ", possibly because memory ran out" if name == "SIGKILL" else ""
        return record._replace(state=INTERRUPTED, reason=f"its process was ended by {name}{hint}")
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    sentences = [line.removeprefix("nsm: ") for line in lines if line.startswith("nsm: ")]
    nothing = f"it ended with status {status} and without a summary"
    return record._replace(state=FAILED, reason=(sentences or lines or [nothing])[-1])


def _rounded(steps: float) -> int:
    """Round a number of steps down to a few digits."""
    unit = 10 ** max(0, len(str(int(steps))) - _DIGITS)
    return int(steps) // unit * unit
