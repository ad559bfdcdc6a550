"""Checkpoints: the last one to resume from, and the best one to use."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import lightning as L
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.trainer.states import TrainerFn

from nsm.io.checkpoint import load_morph
from nsm.types import Morph


class Checkpoints(ModelCheckpoint):
    """Writes ``last.ckpt`` at every validation and at the end, and ``best.ckpt`` whenever ``val/error`` is lowest.

    ``val/error`` is measured on fixed points and on the surface at all times (`nsm.train.tasks.MorphTask`), so that the
    choice does not depend on a random batch. All results use the best checkpoint: the meshes and the strip at the end
    of training, ``summary.json``, `nsm.load_morph`, and all commands.

    Args:
        folder: Folder of the checkpoints.

    Attributes:
        best_step: Step of ``best.ckpt``; None before the first validation.
        best_figures: Figures of the validation at that step, by the names in the log.
    """

    best_step: int | None = None
    best_figures: dict[str, float]

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
        self.best_figures = {}

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write this step, also as the best one if it is."""
        super().on_validation_end(trainer, pl_module)
        if trainer.state.fn == TrainerFn.FITTING and not trainer.sanity_checking:
            self._keep_last(trainer)

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write the last step, even if it lies between two validations."""
        super().on_train_end(trainer, pl_module)
        self._keep_last(trainer)

    def state_dict(self) -> dict[str, Any]:
        """Return the state with the best step, which a resumed run needs."""
        return super().state_dict() | {"best_step": self.best_step, "best_figures": self.best_figures}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the best step of a run that was stopped."""
        super().load_state_dict(state_dict)
        self.best_step, self.best_figures = state_dict["best_step"], dict(state_dict["best_figures"])

    def _save_checkpoint(self, trainer: L.Trainer, filepath: str) -> None:
        """Write the best checkpoint, in which this step is already the best, since a run may resume from it."""
        self.best_step = trainer.global_step
        figures = trainer.callback_metrics
        self.best_figures = {name: float(v) for name, v in figures.items() if name.startswith("val/")}
        super()._save_checkpoint(trainer, filepath)

    def _keep_last(self, trainer: L.Trainer) -> None:
        for logger in trainer.loggers:
            logger.save()  # a run that resumes from here logs no earlier step again
        # Lightning's save_last writes only when the best checkpoint has changed too
        trainer.save_checkpoint(Path(self.dirpath or ".") / "last.ckpt", weights_only=False)


class Best(NamedTuple):
    """The morph that a run ends with, as loaded from ``best.ckpt``, and its step."""

    morph: Morph
    step: int


def best_morph(trainer: L.Trainer, current: Morph) -> Best:
    """Load the best morph so far, or return the one in training if the run keeps no checkpoints.

    Args:
        trainer: Trainer of the run.
        current: Morph in training.
    """
    checkpoints = trainer.checkpoint_callback
    if not isinstance(checkpoints, Checkpoints) or checkpoints.best_step is None:
        return Best(current, trainer.global_step)
    file = Path(checkpoints.dirpath or ".") / "best.ckpt"
    return Best(load_morph(file, current.bounds.device), checkpoints.best_step)
