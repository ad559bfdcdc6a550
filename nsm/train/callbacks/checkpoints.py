"""Checkpoints: the last, to go on from, and the best, to use."""

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

    ``val/error`` is measured on fixed points and on the surface at all times (`nsm.train.tasks.MorphTask`), so the best
    checkpoint is not that of a lucky batch. It is the one that everything uses: the meshes and the strip at the end of
    training, ``summary.json``, `nsm.load_morph` and with it all commands.

    Args:
        folder: where they go.

    Attributes:
        best_step: Step of ``best.ckpt``; None before the first validation.
        best_figures: What the validation of that step measured, by the names of the log.
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
        """Keep this step, and look whether it is the best."""
        before = self.best_model_score
        super().on_validation_end(trainer, pl_module)
        if trainer.state.fn == TrainerFn.FITTING and not trainer.sanity_checking:
            if self.best_model_score is not before:
                self.best_step = trainer.global_step
                figures = trainer.callback_metrics
                self.best_figures = {name: float(v) for name, v in figures.items() if name.startswith("val/")}
            self._keep_last(trainer)

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Keep the last step, also where it lies between two validations."""
        super().on_train_end(trainer, pl_module)
        self._keep_last(trainer)

    def state_dict(self) -> dict[str, Any]:
        """The state with the best step, so that a resumed run knows it."""
        return super().state_dict() | {"best_step": self.best_step, "best_figures": self.best_figures}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take over the best step of a run that was stopped."""
        super().load_state_dict(state_dict)
        self.best_step, self.best_figures = state_dict["best_step"], dict(state_dict["best_figures"])

    def _keep_last(self, trainer: L.Trainer) -> None:
        # Lightning's own save_last writes only when the best has changed too
        trainer.save_checkpoint(Path(self.dirpath or ".") / "last.ckpt", weights_only=False)


class Best(NamedTuple):
    """The morph that a run ends with: that of ``best.ckpt``, as it is loaded from there, and its step."""

    morph: Morph
    step: int


def best_morph(trainer: L.Trainer, current: Morph) -> Best:
    """The best morph so far; the one in training if the run keeps no checkpoints.

    Args:
        trainer: Of the run.
        current: The morph in training.
    """
    checkpoints = trainer.checkpoint_callback
    if not isinstance(checkpoints, Checkpoints) or checkpoints.best_step is None:
        return Best(current, trainer.global_step)
    file = Path(checkpoints.dirpath or ".") / "best.ckpt"
    return Best(load_morph(file, current.bounds.device), checkpoints.best_step)
