"""A study whose workers are killed finishes, and runs nothing twice."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import cloudpickle
import pytest
from nightly import tries
from table import Tally

from nsm.cli import entry
from nsm.compare import __main__ as compare
from nsm.compare.record import DONE, read_record

#: Runs of the study, and those among them that kill their worker.
RUNS = tries(8, 100)
KILLERS = (RUNS // 4, RUNS // 2)
STEPS = 10

#: In place of training: steps that take a moment, of which each is a line in a file that a resumed run continues. Two
#: runs kill their worker in the middle, once.
TRAINING = """
import fcntl, json, os, signal, sys, time
from pathlib import Path

settings = dict(argument.partition("=")[::2] for argument in sys.argv[1:])
folder = Path(settings["hydra.run.dir"].strip("'"))
alone = (folder / "alone").open("w")
fcntl.flock(alone, fcntl.LOCK_EX | fcntl.LOCK_NB)  # an error where another process trains in this folder
steps = folder / "steps"
with (folder / "starts").open("a") as file:
    print(os.getppid(), file=file)
while (done := len(steps.read_text().split()) if steps.exists() else 0) < %(steps)d:
    with steps.open("a") as file:
        print(done, file=file)
    time.sleep(0.02)
    killed = folder / "killed"
    if int(settings["seed"]) in %(killers)s and done == 4 and not killed.exists():
        killed.touch()
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(60)
with (folder / "ends").open("a") as file:
    print(os.getppid(), file=file)
(folder / "summary.json").write_text(json.dumps({"steps": done, "training_s": 1.0}))
"""


def in_worker(config: Any) -> str:
    """Carry out a run with the stand-in for training; a worker cannot import tests."""
    from nsm.compare import run

    run.COMMAND = "quick_training"
    return run.carry_out(config)


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, ...]]:
    """Arguments of a study that trains by the stand-in, in two workers."""
    (tmp_path / "quick_training.py").write_text(TRAINING % {"steps": STEPS, "killers": KILLERS})
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    monkeypatch.setattr(compare, "carry_out", in_worker)
    yield (
        "+study=figure2",
        "methods=[free]",
        "learning_rates=null",
        f"seeds={list(range(RUNS))}",
        "minutes=null",
        f"steps={STEPS}",
        f"output={tmp_path / 'study'}",
        "hydra/launcher=workers",
    )
    cloudpickle.unregister_pickle_by_value(sys.modules[__name__])


def lines(file: Path) -> list[int]:
    return [int(line) for line in file.read_text().split()]


def test_a_study_with_two_workers_killed_finishes_and_runs_nothing_twice(
    study: tuple[str, ...], tmp_path: Path, tally: Tally
) -> None:
    with tally.attack(f"a study of {RUNS} runs, two of which kill their worker"):
        with mock.patch.object(sys, "argv", ["nsm.compare", *study]):
            entry.run(compare.main, "compare")
        folders = sorted((tmp_path / "study" / "runs").rglob("run.json"))
        assert len(folders) == RUNS
        assert sum((file.parent / "killed").exists() for file in folders) == len(KILLERS)
        for folder in (file.parent for file in folders):
            assert read_record(folder).state == DONE, (folder / "output.log").read_text()  # type: ignore[union-attr]
            assert lines(folder / "steps") == list(range(STEPS)), "each step is made once"
            assert lines(folder / "ends"), "it ends, and once more if its worker is killed before that is recorded"
        again = [folder for file in folders if len(lines((folder := file.parent) / "starts")) > 1]
        # a kill takes along what the worker and the one beside it were training
        assert len(KILLERS) <= len(again) <= 2 * len(KILLERS)
        assert len(json.loads((tmp_path / "study" / "study.json").read_text())["rows"]) == RUNS
