"""Checkpoints: the last, to go on from, and the best, to use."""

from __future__ import annotations

from pathlib import Path

import lightning as L
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.trainer.states import TrainerFn


class Checkpoints(ModelCheckpoint):
    """Writes ``last.ckpt`` at every validation and at the end, and ``best.ckpt`` whenever ``val/error`` is lowest.

    ``val/error`` is measured on fixed points and on the volume curve (`nsm.tasks.MorphTask`), so the best checkpoint
    is not that of a lucky batch.

    Args:
        folder: where they go.
    """

    def __init__(self, folder: str) -> None:
        super().__init__(
            dirpath=folder,
            filename="best",
            monitor="val/error",
            mode="min",
            save_top_k=1,
            enable_version_counter=False,
            auto_insert_metric_name=False,
        )

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Keep this step, and look whether it is the best."""
        super().on_validation_end(trainer, pl_module)
        if trainer.state.fn == TrainerFn.FITTING and not trainer.sanity_checking:
            self._keep_last(trainer)

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Keep the last step, also where it lies between two validations."""
        super().on_train_end(trainer, pl_module)
        self._keep_last(trainer)

    def _keep_last(self, trainer: L.Trainer) -> None:
        # Lightning's own save_last writes only when the best has changed too
        trainer.save_checkpoint(Path(self.dirpath or ".") / "last.ckpt", weights_only=False)
