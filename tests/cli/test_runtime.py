"""What the package asks of the machine."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

#: Import the package first, then say what OpenMP would read, and whether torch was there before.
PROGRAM = "import nsm, os, sys; print(os.environ.get('GOMP_SPINCOUNT'), 'torch' in sys.modules)"


def told(**chosen: str) -> list[str]:
    """What a fresh process prints with these settings in its environment."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("OMP_", "GOMP_"))}
    command = [sys.executable, "-c", PROGRAM]
    return subprocess.run(command, env=kept | chosen, capture_output=True, text=True, check=True).stdout.split()


def test_waiting_threads_give_their_core_away_soon_and_torch_is_told_in_time() -> None:
    looks, torch_was_there = told()
    assert 0 < int(looks) < 300_000
    assert torch_was_there == "False"


@pytest.mark.parametrize(
    ("name", "value", "looks"), [("GOMP_SPINCOUNT", "123", "123"), ("OMP_WAIT_POLICY", "active", "None")]
)
def test_the_settings_of_the_user_win(name: str, value: str, looks: str) -> None:
    assert told(**{name: value})[0] == looks
