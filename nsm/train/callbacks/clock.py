"""Duration of a run over all its sessions."""

from __future__ import annotations

import time
from typing import Any

import lightning as L


class TrainingClock(L.Callback):
    """Counts the seconds since it was made, and those of the sessions before the run was stopped and resumed."""

    def __init__(self) -> None:
        self._begin = time.monotonic()
        self._before = 0.0
        self._started = False

    @property
    def seconds(self) -> float:
        """Seconds of training so far."""
        return self._before + time.monotonic() - self._begin

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Note that checkpoints are of this session from now on, to which a collapse may go back."""
        self._started = True

    def state_dict(self) -> dict[str, Any]:
        """Return the seconds so far."""
        return {"seconds": self.seconds}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the seconds of earlier sessions."""
        if not self._started:
            self._before = float(state_dict["seconds"])
