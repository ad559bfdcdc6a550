"""Checkpoints: the last, to go on from, and the best, to use."""

from __future__ import annotations

from pathlib import Path

import lightning as L
from lightning.pytorch.callbacks import ModelCheckpoint


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
            save_last=True,
            enable_version_counter=False,
            auto_insert_metric_name=False,
        )

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Keep the last step, also where it lies between two validations."""
        super().on_train_end(trainer, pl_module)
        trainer.save_checkpoint(Path(self.dirpath or ".") / "last.ckpt")
