"""Duration of training and of one step."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import lightning as L

from nsm.cli.files import atomic_write

#: Steps at the start of training that are not counted, while caches, memory, and preconditioners are set up.
WARM_UP = 10


class StepTimes(L.Callback):
    """Writes ``step_times.json``: seconds of training, summed over resumed runs, and seconds per step.

    A step lasts from the end of the previous one to its own end, which includes drawing points but no validation.

    Args:
        folder: Folder of the file.
    """

    def __init__(self, folder: str) -> None:
        self.file = Path(folder) / "step_times.json"
        #: Seconds of training before this run was resumed.
        self.before = 0.0
        #: Seconds per step then.
        self.step_before: float | None = None
        self.steps: list[float] = []
        self._begin: float | None = None
        self._last = 0.0

    def state_dict(self) -> dict[str, Any]:
        """Return the seconds of training so far, which a resumed run adds to, and those per step."""
        return {"seconds": self._seconds(), "step_s": self._step_seconds()}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the seconds of a run that was stopped."""
        self.before, self.step_before = float(state_dict["seconds"]), state_dict.get("step_s")

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Start the clock."""
        self._begin = self._last = time.perf_counter()

    def on_train_batch_end(
        self, trainer: L.Trainer, pl_module: L.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Record one step."""
        now = time.perf_counter()
        self.steps.append(now - self._last)
        self._last = now

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Restart the clock, since validation belongs to no step."""
        self._last = time.perf_counter()

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write the file."""
        step_s = self._step_seconds()
        if step_s is None:
            return
        times = {"training_s": self._seconds(), "step_s": step_s}
        with atomic_write(self.file) as temporary:
            temporary.write_text(json.dumps(times, indent=2) + "\n")

    def _step_seconds(self) -> float | None:
        """Seconds per step, of the steps since the run began or was resumed if there are any."""
        counted = self.steps[WARM_UP:] or self.steps[-1:]
        return sum(counted) / len(counted) if counted else self.step_before

    def _seconds(self) -> float:
        return self.before + (0.0 if self._begin is None else time.perf_counter() - self._begin)


class Unvalidated(L.Callback):
    """Skips all validations."""

    def setup(self, trainer: L.Trainer, pl_module: L.LightningModule, stage: str) -> None:
        """Limit the trainer to no validation batches."""
        trainer.limit_val_batches = 0
