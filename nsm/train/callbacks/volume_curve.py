"""Volume over time at every validation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import lightning as L

from nsm.cli.files import atomic_write
from nsm.metrics import VolumeCurve
from nsm.plots.curves import plot_volume_curves, write_volume_curve
from nsm.train.callbacks.checkpoints import Checkpoints
from nsm.train.callbacks.tracker import Trackers
from nsm.train.callbacks.writer import MorphWriter
from nsm.train.tasks import MorphTask
from nsm.types import Morph


class VolumeCurveLog(MorphWriter):
    """Keeps the volume curve of every validation.

    Writes ``volume_history.csv`` (step, time, volume) and the last curve as ``volume.csv`` and ``volume.png``, at the
    end of training that of ``best.ckpt``. Trackers get the curve as a table and as a picture.

    Args:
        folder: Folder of these files.
    """

    def __init__(self, folder: str) -> None:
        self.folder = Path(folder)
        self._history: list[tuple[int, VolumeCurve]] = []

    def write(self, morph: Morph, curve: VolumeCurve, label: str, trackers: Trackers) -> None:
        picture = self.folder / "volume.png"
        write_volume_curve(self.folder / "volume.csv", curve.times, curve.volumes)
        plot_volume_curves(picture, {label: (curve.times, curve.volumes)})
        trackers.picture("volume", picture)
        trackers.curve("volume_curve", curve)

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write the curve that validation measured."""
        if not isinstance(pl_module, MorphTask) or pl_module.volume_curve is None:
            return
        if trainer.sanity_checking or not trainer.is_global_zero:
            return
        self._history.append((trainer.global_step, pl_module.volume_curve))
        with atomic_write(self.folder / "volume_history.csv") as temporary:
            rows = [f"{step},{t:g},{v:.9g}" for step, c in self._history for t, v in _rows(c)]
            temporary.write_text("\n".join(["step,time,volume", *rows, ""]))
        self._show(trainer, pl_module.morph, *self._history[-1])

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Show the curve of the best step."""
        checkpoints = trainer.checkpoint_callback
        if not isinstance(checkpoints, Checkpoints) or not trainer.is_global_zero:
            return
        best = [(step, curve) for step, curve in self._history if step == checkpoints.best_step]
        if isinstance(pl_module, MorphTask) and best and checkpoints.best_step != self._history[-1][0]:
            self._show(trainer, pl_module.morph, *best[-1])

    def _show(self, trainer: L.Trainer, morph: Morph, step: int, curve: VolumeCurve) -> None:
        self.write(morph, curve, f"step {step}", Trackers.of(trainer))

    def state_dict(self) -> dict[str, Any]:
        """Return the curves so far, with which a resumed run continues."""
        return {"history": [[step, c.times, c.volumes] for step, c in self._history]}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the curves so far."""
        self._history = [(step, VolumeCurve(times, volumes)) for step, times, volumes in state_dict["history"]]


def _rows(curve: VolumeCurve) -> list[tuple[float, float]]:
    return list(zip(curve.times.tolist(), curve.volumes.tolist(), strict=True))
