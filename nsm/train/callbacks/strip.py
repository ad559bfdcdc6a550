"""A picture of the best morph when training is done."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import lightning as L

from nsm.plots.strip import try_strip
from nsm.train.callbacks.checkpoints import best_morph
from nsm.train.callbacks.volume_curve import log_picture


class Strip(L.Callback):
    """Writes ``strip.png``, the morph of ``best.ckpt`` at some times, at the end of training.

    A warning says why where it cannot be drawn.

    Args:
        folder: where it goes.
        times: of the columns.
        size: pixels along an edge of one picture.
    """

    def __init__(self, folder: str, times: Sequence[float], size: int = 400) -> None:
        self.file = Path(folder) / "strip.png"
        self.times, self.size = tuple(times), size

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Draw the strip."""
        morph = getattr(pl_module, "morph", None)
        if morph is None or not trainer.is_global_zero or trainer.global_step < trainer.max_steps:
            return
        if try_strip(self.file, best_morph(trainer, morph).morph, self.times, size=self.size):
            log_picture(trainer, "strip", self.file)
