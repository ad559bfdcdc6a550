"""How long training takes, and one step of it."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import lightning as L

from nsm.cli.files import whole_file

#: Steps at the start of training that are not counted: caches, memory and preconditioners are still being set up.
WARM_UP = 10


class StepTimes(L.Callback):
    """Writes ``step_times.json``: seconds of training, resumed ones added up, and of one step.

    A step is counted from the end of one to the end of the next, so that drawing points is part of it and validation
    is not.

    Args:
        folder: where the file goes.
    """

    def __init__(self, folder: str) -> None:
        self.file = Path(folder) / "step_times.json"
        #: Of the sessions before this one.
        self.before = 0.0
        self.steps: list[float] = []
        self._begin: float | None = None
        self._last = 0.0

    def state_dict(self) -> dict[str, Any]:
        """The seconds of training up to now, which a resumed run goes on from."""
        return {"seconds": self._seconds()}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take over the seconds of a run that was stopped."""
        self.before = float(state_dict["seconds"])

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Start the clock."""
        self._begin = self._last = time.perf_counter()

    def on_train_batch_end(
        self, trainer: L.Trainer, pl_module: L.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Note one step."""
        now = time.perf_counter()
        self.steps.append(now - self._last)
        self._last = now

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Go on from here: what a validation took belongs to no step."""
        self._last = time.perf_counter()

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write the file."""
        if not self.steps:
            return
        counted = self.steps[WARM_UP:] or self.steps[-1:]
        times = {
            "training_s": self._seconds(),
            "step_s": sum(counted) / len(counted),
        }
        with whole_file(self.file) as temporary:
            temporary.write_text(json.dumps(times, indent=2) + "\n")

    def _seconds(self) -> float:
        return self.before + (0.0 if self._begin is None else time.perf_counter() - self._begin)


class Unvalidated(L.Callback):
    """Leaves out every validation of the training that it is given to."""

    def setup(self, trainer: L.Trainer, pl_module: L.LightningModule, stage: str) -> None:
        """Tell the trainer."""
        trainer.limit_val_batches = 0
