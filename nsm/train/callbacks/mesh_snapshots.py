"""Meshes of the morph at chosen times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import lightning as L
import numpy as np
from lightning.pytorch.loggers import WandbLogger

from nsm.io.mesh import write_mesh
from nsm.metrics import VolumeCurve
from nsm.morphs.surfaces import extract_frame
from nsm.train.callbacks.checkpoints import best_morph
from nsm.train.callbacks.writer import MorphWriter
from nsm.train.tasks import MorphTask
from nsm.types import Morph, SimplexMesh

#: File format of a surface and of a curve, by dimension.
_SUFFIXES = {3: ".ply", 2: ".obj"}


class MeshSnapshots(MorphWriter):
    """Writes meshes (``.ply``, in 2D ``.obj``), and logs them to wandb.

    Some validations write ``meshes/step_<step>/t_<time>.ply``; the end of training writes the meshes of ``best.ckpt``,
    ``meshes/best/t_<time>.ply``.

    Args:
        folder: Folder in which ``meshes`` is made.
        times: Times of the snapshots, in [0, 1].
        resolution: Cells along the box.
        every: Number of validations from one snapshot to the next.
    """

    def __init__(self, folder: str, times: Sequence[float], resolution: int = 96, every: int = 5) -> None:
        self.folder = Path(folder) / "meshes"
        self.times, self.resolution, self.every = tuple(times), resolution, every
        self._validations = 0

    def write(self, morph: Morph, curve: VolumeCurve, label: str) -> None:
        for time in self.times:
            self._snapshot(morph, "best", time)

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write the meshes of this step, if it is due."""
        if not isinstance(pl_module, MorphTask) or trainer.sanity_checking or not trainer.is_global_zero:
            return
        self._validations += 1
        if not self._validations % self.every:
            self._write_and_log(trainer, pl_module.morph, f"step_{trainer.global_step:06d}")

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write the meshes of the best step."""
        if not isinstance(pl_module, MorphTask) or not trainer.is_global_zero:
            return
        if trainer.global_step >= trainer.max_steps:
            self._write_and_log(trainer, best_morph(trainer, pl_module.morph).morph, "best")

    def _write_and_log(self, trainer: L.Trainer, morph: Morph, name: str) -> None:
        for time in self.times:
            mesh = self._snapshot(morph, name, time)
            for logger in trainer.loggers:
                if isinstance(logger, WandbLogger):
                    _log_mesh(logger, f"mesh/t_{time:.3f}", mesh, trainer.global_step)

    def _snapshot(self, morph: Morph, name: str, time: float) -> SimplexMesh:
        frame = extract_frame(morph, time, self.resolution)
        write_mesh(self.folder / name / f"t_{time:.3f}{_SUFFIXES[morph.dim]}", frame.mesh, frame.normals)
        return frame.mesh


def _log_mesh(logger: WandbLogger, name: str, mesh: SimplexMesh, step: int) -> None:
    """Log the vertices of a mesh in 3D as a point cloud, which is what wandb shows."""
    if mesh.vertices.shape[1] == 3:
        import wandb

        logger.experiment.log({name: wandb.Object3D(np.asarray(mesh.vertices.cpu())), "trainer/global_step": step})
