"""Picture of the best morph at the end of training."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import lightning as L

from nsm.metrics import VolumeCurve, with_key_times
from nsm.plots.strip import try_strip
from nsm.train.callbacks.checkpoints import best_morph
from nsm.train.callbacks.tracker import Trackers
from nsm.train.callbacks.writer import MorphWriter
from nsm.train.tasks import MorphTask
from nsm.types import Morph

#: Times of the columns of a strip, more of them in the middle of the motion.
TIMES = (0.0, 0.2, 0.4, 0.5, 0.6, 0.8, 1.0)


class Strip(MorphWriter):
    """Writes ``strip.png``, the morph of ``best.ckpt`` at some times, at the end of training.

    Where it cannot be drawn, a warning says why.

    Args:
        folder: Folder of the picture.
        times: Times of the columns, in [0, 1]; None for `TIMES` and those of the shapes that the morph passes through.
        size: Pixels along an edge of one picture.
    """

    def __init__(self, folder: str, times: Sequence[float] | None = None, size: int = 400) -> None:
        self.file = Path(folder) / "strip.png"
        self.times, self.size = times, size

    def write(self, morph: Morph, curve: VolumeCurve, label: str, trackers: Trackers) -> None:
        self._draw(morph, trackers)

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Draw the strip of the best step."""
        if not isinstance(pl_module, MorphTask) or not trainer.is_global_zero:
            return
        if trainer.global_step >= trainer.max_steps:
            self._draw(best_morph(trainer, pl_module.morph).morph, Trackers.of(trainer))

    def _draw(self, morph: Morph, trackers: Trackers) -> None:
        times = with_key_times(morph, TIMES) if self.times is None else self.times
        if try_strip(self.file, morph, times, size=self.size):
            trackers.picture("strip", self.file)
