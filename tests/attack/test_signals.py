"""A signal to one of several processes that train together ends them all in order."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from nightly import NIGHTLY
from runs import BARE
from table import Tally

#: Two processes on one machine without a GPU.
TWO = ("trainer.devices=2", "trainer.strategy=ddp", "steps=100000", "validations=1000")


@pytest.mark.skipif(not NIGHTLY, reason="takes a minute: make nightly")
@pytest.mark.parametrize("number", range(3))
def test_a_signal_to_the_first_of_two_processes_ends_both_with_a_sentence(
    number: int, tmp_path: Path, tally: Tally
) -> None:
    few = [o for o in BARE if not o.startswith(("steps", "validations"))]
    command = [sys.executable, "-m", "nsm.train", *few, *TWO, f"hydra.run.dir={tmp_path}"]
    last = tmp_path / "checkpoints" / "last.ckpt"
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with (tmp_path / "said.txt").open("w") as said, tally.attack("SIGTERM to one of two processes of a training"):
        process = subprocess.Popen(command, stdout=said, stderr=said, env=environment)
        try:
            deadline = time.monotonic() + 600
            while not last.is_file():
                assert process.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.05)
            time.sleep(random.Random(number).uniform(0, 1))
            process.send_signal(signal.SIGTERM)
            assert process.wait(300) == 128 + signal.SIGTERM
        finally:
            process.kill()
        text = (tmp_path / "said.txt").read_text()
        assert "Traceback" not in text
        assert text.count("Training stopped at step") == 1
        assert torch.load(last, weights_only=True)["global_step"] > 0
