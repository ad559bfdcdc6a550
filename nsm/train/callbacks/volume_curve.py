"""The volume curve, as it settles during training."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.loggers import TensorBoardLogger, WandbLogger
from torch import Tensor

from nsm.cli.files import whole_file
from nsm.metrics import VolumeCurve
from nsm.plots.curves import plot_volume_curves, write_volume_curve
from nsm.train.callbacks.checkpoints import Checkpoints


class VolumeCurveLog(L.Callback):
    """Keeps the volume curve of every validation.

    Writes ``volume_history.csv`` (step, time, volume), the last curve as ``volume.csv`` and ``volume.png``, in the end
    that of ``best.ckpt``, and gives the picture to the loggers that take images.

    Args:
        folder: where they go.
    """

    def __init__(self, folder: str) -> None:
        self.folder = Path(folder)
        self._history: list[tuple[int, VolumeCurve]] = []

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write the curve that validation measured."""
        curve = getattr(pl_module, "volume_curve", None)
        if curve is None or trainer.sanity_checking or not trainer.is_global_zero:
            return
        self._history.append((trainer.global_step, curve))
        with whole_file(self.folder / "volume_history.csv") as temporary:
            rows = [f"{step},{t:g},{v:.9g}" for step, c in self._history for t, v in _pairs(c)]
            temporary.write_text("\n".join(["step,time,volume", *rows, ""]))
        self._show(trainer, trainer.global_step, curve)

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Show the curve of the best step."""
        checkpoints = trainer.checkpoint_callback
        if not isinstance(checkpoints, Checkpoints) or not trainer.is_global_zero:
            return
        best = [curve for step, curve in self._history if step == checkpoints.best_step]
        if checkpoints.best_step is not None and best and checkpoints.best_step != self._history[-1][0]:
            self._show(trainer, checkpoints.best_step, best[-1])

    def _show(self, trainer: L.Trainer, step: int, curve: VolumeCurve) -> None:
        write_volume_curve(self.folder / "volume.csv", curve.times, curve.volumes)
        picture = self.folder / "volume.png"
        plot_volume_curves(picture, {f"step {step}": (curve.times, curve.volumes)})
        log_picture(trainer, "volume", picture)

    def state_dict(self) -> dict[str, Any]:
        """The curves so far, so that a resumed run goes on with them."""
        return {"history": [[step, c.times, c.volumes] for step, c in self._history]}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take the curves so far."""
        self._history = [(step, VolumeCurve(times, volumes)) for step, times, volumes in state_dict["history"]]


def log_picture(trainer: L.Trainer, name: str, picture: Path) -> None:
    """Give a picture to every logger that takes one."""
    for logger in trainer.loggers:
        if isinstance(logger, WandbLogger):
            logger.log_image(key=name, images=[str(picture)], step=trainer.global_step)
        elif isinstance(logger, TensorBoardLogger):
            logger.experiment.add_image(name, _pixels(picture), trainer.global_step, dataformats="HWC")


def _pixels(picture: Path) -> Tensor:
    from matplotlib.image import imread

    return torch.from_numpy(imread(picture)[..., :3].copy())


def _pairs(curve: VolumeCurve) -> list[tuple[float, float]]:
    return list(zip(curve.times.tolist(), curve.volumes.tolist(), strict=True))
