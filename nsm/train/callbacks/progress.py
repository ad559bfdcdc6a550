"""Progress of training: step, loss, last validation, and time left."""

from __future__ import annotations

from typing import Any

import lightning as L
from lightning.pytorch.callbacks import ProgressBar

from nsm.cli import progress
from nsm.train.summary import shown_figures
from nsm.train.tasks import FieldTask


class Progress(ProgressBar):
    """Shows all optimizer steps with the loss, the figures of the last validation, and the time left.

    On a terminal that is a bar; otherwise a line every half minute (`nsm.cli.progress`).

    Args:
        title: Text in front of the bar.
    """

    def __init__(self, title: str = "training") -> None:
        super().__init__()
        self.title = title
        self._enabled = True
        self._shown: progress.Progress | None = None
        self._loss = self._validation = ""

    def disable(self) -> None:
        """Show nothing; Lightning calls this on all processes but the first."""
        self._enabled = False

    def enable(self) -> None:
        """Show the bar."""
        self._enabled = True

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Open the bar at the step where training begins or resumes."""
        if self._enabled:
            self._shown = progress.Progress(self.title, trainer.max_steps, trainer.global_step, unit="steps")
            self._shown.open()

    def on_train_batch_end(  # type: ignore[override]
        self, trainer: L.Trainer, pl_module: FieldTask, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Show the step and its loss."""
        self._loss = f"loss {float(pl_module.latest['train/loss']):.3g}"
        self._update(trainer)

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Show the figures of this validation."""
        figures = {name: float(value) for name, value in trainer.callback_metrics.items()}
        self._validation = f"; validation at step {trainer.global_step}: {', '.join(shown_figures(figures))}"
        self._update(trainer)

    def _update(self, trainer: L.Trainer) -> None:
        if self._shown is not None:
            self._shown.update(completed=trainer.global_step, detail=self._loss + self._validation)

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Finish the bar."""
        if self._shown is not None:
            self._shown.finish()
            self._shown = None

    def on_exception(self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException) -> None:
        """Close the bar without a last line."""
        if self._shown is not None:
            self._shown.close()
            self._shown = None
