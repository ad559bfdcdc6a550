"""One line that tells how training goes and how long it will take."""

from __future__ import annotations

from typing import Any

import lightning as L
from lightning.pytorch.callbacks import ProgressBar
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

from nsm.train.tasks import FieldTask

#: What the line shows of the figures, under which name, and how.
_FIGURES = {
    "train/loss": "loss {:.3g}",
    "val/error": "error {:.2g}",
    "val/volume_max": "volume ±{:.2%}",
    "val/components": "components {:.0f}",
    "val/normal": "normals {:.1f}°",
}


class Progress(ProgressBar):
    """A bar over all optimiser steps, with the loss, the validation figures and the time left.

    Args:
        title: stands before the bar.
    """

    def __init__(self, title: str = "training") -> None:
        super().__init__()
        self.title = title
        self._bar: RichProgress | None = None

    def disable(self) -> None:
        """Show nothing (asked by Lightning on all processes but the first)."""
        self._enabled = False

    def enable(self) -> None:
        """Show the bar."""
        self._enabled = True

    _enabled = True

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Begin at the step that training stands at."""
        if not self._enabled:
            return
        self._bar = RichProgress(
            TextColumn(self.title),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[figures]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
        )
        self._task = self._bar.add_task("", total=trainer.max_steps, completed=trainer.global_step, figures="")
        self._bar.start()

    def on_train_batch_end(  # type: ignore[override]
        self, trainer: L.Trainer, pl_module: FieldTask, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Move on."""
        if self._bar is not None:
            measured = {**trainer.callback_metrics, **pl_module.latest}
            known = {name: float(v) for name in _FIGURES if (v := measured.get(name)) is not None}
            figures = "  ".join(_FIGURES[name].format(value) for name, value in known.items())
            self._bar.update(self._task, completed=trainer.global_step, figures=figures)

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Finish the line."""
        self._stop()

    def on_exception(self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException) -> None:
        """Finish the line."""
        self._stop()

    def _stop(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
