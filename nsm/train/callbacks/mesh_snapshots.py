"""Meshes of the morph at chosen times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import lightning as L
import numpy as np
from lightning.pytorch.loggers import WandbLogger

from nsm.io.mesh import write_mesh
from nsm.morphs.surfaces import extract_frame
from nsm.train.callbacks.checkpoints import best_morph
from nsm.types import Morph, SimplexMesh

#: The format of a surface and of a curve.
_SUFFIXES = {3: ".ply", 2: ".obj"}


class MeshSnapshots(L.Callback):
    """Writes meshes (``.ply``, in 2D ``.obj``), and gives them to wandb.

    On the way, at some validations, ``meshes/step_<step>/t_<time>.ply``; at the end of training those of ``best.ckpt``,
    ``meshes/best/t_<time>.ply``.

    Args:
        folder: where ``meshes`` goes.
        times: of the snapshots.
        resolution: cells along the box.
        every: at every how many-th validation.
    """

    def __init__(self, folder: str, times: Sequence[float], resolution: int = 96, every: int = 5) -> None:
        self.folder = Path(folder) / "meshes"
        self.times, self.resolution, self.every = tuple(times), resolution, every
        self._validations = 0

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write the meshes of this step."""
        morph = getattr(pl_module, "morph", None)
        if morph is None or trainer.sanity_checking or not trainer.is_global_zero:
            return
        self._validations += 1
        if not self._validations % self.every:
            self._write(trainer, morph, f"step_{trainer.global_step:06d}", trainer.global_step)

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write the meshes of the best step."""
        morph = getattr(pl_module, "morph", None)
        if morph is None or not trainer.is_global_zero or trainer.global_step < trainer.max_steps:
            return
        self._write(trainer, best_morph(trainer, morph).morph, "best", trainer.global_step)

    def _write(self, trainer: L.Trainer, morph: Morph, name: str, step: int) -> None:
        for time in self.times:
            file = self.folder / name / f"t_{time:.3f}{_SUFFIXES[morph.dim]}"
            frame = extract_frame(morph, time, self.resolution)
            write_mesh(file, frame.mesh, frame.normals)
            for logger in trainer.loggers:
                if isinstance(logger, WandbLogger):
                    _log_mesh(logger, f"mesh/t_{time:.3f}", frame.mesh, step)


def _log_mesh(logger: WandbLogger, name: str, mesh: SimplexMesh, step: int) -> None:
    """wandb shows point clouds in three dimensions; the vertices of the mesh make one."""
    if mesh.vertices.shape[1] == 3:
        import wandb

        logger.experiment.log({name: wandb.Object3D(np.asarray(mesh.vertices.cpu())), "trainer/global_step": step})
