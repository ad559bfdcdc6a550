"""Processes that train together end together, whichever of them dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from analytic import sentence
from nightly import NIGHTLY
from runs import BARE
from table import Tally

#: Two processes on the processor for a run that lasts.
RUN = (*BARE, "trainer.devices=2", "trainer.strategy=ddp", "steps=5000", "validations=1000")


def begun(folder: Path) -> subprocess.Popen[str]:
    """Start two processes with the command, and wait for their first checkpoint."""
    command = [sys.executable, "-m", "nsm", "train", *RUN, f"hydra.run.dir={folder}"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NSM_CACHE_DIR": str(folder / "cache")}
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
    wait_for((folder / "checkpoints" / "last.ckpt").is_file, process)
    return process


def wait_for(what: Callable[[], object], process: subprocess.Popen[str] | None = None) -> None:
    deadline = time.monotonic() + 600
    while not what():
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def children(process: int) -> list[int]:
    """Processes that another one has started and that train."""
    found = Path(f"/proc/{process}/task").glob("*/children")
    pids = [int(child) for file in found for child in file.read_text().split()]
    return [pid for pid in pids if b"nsm.train" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def test_a_process_that_dies_ends_all_with_a_sentence(tmp_path: Path, tally: Tally) -> None:
    with tally.attack("a process killed of two that train together"):
        first = begun(tmp_path)
        (second,) = children(first.pid)
        os.kill(second, signal.SIGKILL)
        _, said = first.communicate(timeout=120)
        assert first.returncode == 2
        told = sentence("\n".join(line for line in said.splitlines() if line.startswith("nsm:")))
        assert "must all run to the end, got the end of process 1 with signal 9" in told
        assert f"Try the command with `hydra.run.dir={tmp_path} resume=true`." in told
        assert "Traceback" not in said


@pytest.mark.skipif(not NIGHTLY, reason="trains for a while: make nightly")
def test_when_the_first_process_dies_nobody_trains_on_alone(tmp_path: Path, tally: Tally) -> None:
    with tally.attack("the first process killed of two that train together"):
        first = begun(tmp_path)
        (second,) = children(first.pid)
        first.kill()
        first.communicate(timeout=120)
        wait_for(lambda: not Path(f"/proc/{second}").exists())
