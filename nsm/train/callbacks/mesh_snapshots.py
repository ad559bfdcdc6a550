"""Meshes of the morph at chosen times."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import lightning as L

from nsm.io.mesh import write_mesh
from nsm.metrics import VolumeCurve
from nsm.morphs.surfaces import extract_frame
from nsm.plots.strip import render_strip
from nsm.train.callbacks.checkpoints import best_morph
from nsm.train.callbacks.tracker import Trackers
from nsm.train.callbacks.writer import MorphWriter
from nsm.train.tasks import MorphTask
from nsm.types import Morph

#: File format of a surface and of a curve, by dimension.
_SUFFIXES = {3: ".ply", 2: ".obj"}
#: Width in pixels of the picture of each time that trackers get in 2D.
_SIZE = 300


class MeshSnapshots(MorphWriter):
    """Writes meshes (``.ply``, in 2D ``.obj``), and logs them to trackers: surfaces in 3D, a row of pictures in 2D.

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

    def write(self, morph: Morph, curve: VolumeCurve, label: str, trackers: Trackers) -> None:
        self._snapshots(morph, "best", trackers)

    def on_validation_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write the meshes of this step, if it is due."""
        if not isinstance(pl_module, MorphTask) or trainer.sanity_checking or not trainer.is_global_zero:
            return
        # by the step and not by counting, so that they fall on the same steps in a run that was stopped and resumed
        batches = trainer.fit_loop.total_batch_idx + 1
        if batches % (self.every * int(trainer.val_check_interval)) == 0:
            self._snapshots(pl_module.morph, f"step_{trainer.global_step:06d}", Trackers.of(trainer))

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Write the meshes of the best step."""
        if not isinstance(pl_module, MorphTask) or not trainer.is_global_zero:
            return
        if trainer.global_step >= trainer.max_steps:
            self._snapshots(best_morph(trainer, pl_module.morph).morph, "best", Trackers.of(trainer))

    def _snapshots(self, morph: Morph, name: str, trackers: Trackers) -> None:
        for time in self.times:
            frame = extract_frame(morph, time, self.resolution)
            write_mesh(self.folder / name / f"t_{time:.3f}{_SUFFIXES[morph.dim]}", frame.mesh, frame.normals)
            if morph.dim == 3:
                trackers.surface(f"mesh/t_{time:.3f}", frame)
        if morph.dim == 2 and trackers:
            with tempfile.TemporaryDirectory() as folder:
                picture = Path(folder) / "shapes.png"
                render_strip(picture, morph, self.times, size=_SIZE)
                trackers.picture("shapes", picture)
