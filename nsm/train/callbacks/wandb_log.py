"""Runs of training in Weights & Biases."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers import WandbLogger
from lightning.pytorch.utilities.rank_zero import rank_zero_only

from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.io.gltf import write_glb_frames
from nsm.metrics import VolumeCurve
from nsm.morphs.surfaces import Frame
from nsm.plots.curves import VOLUME_COLUMNS, volume_rows
from nsm.train.callbacks.tracker import Tracker


class WandbLog(WandbLogger, Tracker):
    """Logs curves, tables, pictures, surfaces, and the best checkpoint to Weights & Biases.

    A resumed run of training continues the same run there, whose id is kept in ``wandb/id`` of the run's folder.

    Args:
        save_dir: Folder of the run.
        offline: Whether to write into the folder only, for ``wandb sync``.
        group: Group of the run; None for that of its multirun or study, if any.
        tags: Tags of the run.
        arguments: Further ones of `lightning.pytorch.loggers.WandbLogger` and of ``wandb.init``.
    """

    def __init__(
        self,
        save_dir: str,
        offline: bool = False,
        group: str | None = None,
        tags: Sequence[str] = (),
        **arguments: Any,
    ) -> None:
        self._kept_id = Path(save_dir) / "wandb" / "id"
        # Lightning would set WANDB_MODE, also for later runs of this process
        mode = "offline" if offline else None
        super().__init__(save_dir=save_dir, mode=mode, group=group, tags=list(tags), **arguments)
        del self._wandb_init["anonymous"]  # wandb warns of it

    @rank_zero_only
    def begin(self, config: Mapping[str, Any], group: str | None) -> None:
        import wandb

        self._wandb_init["group"] = self._wandb_init["group"] or group
        if config["resume"] and self._kept_id.is_file():
            self._wandb_init["id"] = self._kept_id.read_text().strip()
        if wandb.run is not None:  # training begins again after a collapse
            self._experiment = wandb.run
        try:
            self.log_hyperparams(dict(config))
        except wandb.Error as error:
            raise InputError(
                f"`logger=wandb` must be logged in to a server that answers, got: {str(error).rstrip('.')}. "
                "Try `wandb login`, or `logger.wandb.offline=true` to write a run that `wandb sync` sends later."
            ) from error
        with atomic_write(self._kept_id) as temporary:
            temporary.write_text(f"{self.experiment.id}\n")

    def rewind(self, step: int) -> None:
        """Keep what was logged, since a run of wandb only grows; of two values at a step, the later one is valid."""

    def picture(self, name: str, file: Path, step: int) -> None:
        self.log_image(key=name, images=[str(file)], step=step)

    def curve(self, name: str, curve: VolumeCurve, step: int) -> None:
        self.log_table(key=name, columns=list(VOLUME_COLUMNS), data=volume_rows(curve.times, curve.volumes), step=step)

    def surface(self, name: str, frame: Frame, step: int) -> None:
        import wandb

        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "surface.glb"
            write_glb_frames(file, [frame], seconds=1.0)
            self.experiment.log({name: wandb.Object3D(str(file)), "trainer/global_step": step})

    def outcome(self, figures: Mapping[str, float], checkpoint: Path, step: int) -> None:
        import wandb

        self.experiment.summary.update(dict(figures))
        if checkpoint.is_file():
            artifact = wandb.Artifact(f"model-{self.experiment.id}", type="model", metadata=dict(figures))
            # the file is final, so that no copy of it needs to be kept until it is sent
            artifact.add_file(str(checkpoint), policy="immutable", skip_cache=True)
            self.experiment.log_artifact(artifact, aliases=["best"])

    def close(self, status: int) -> None:
        if self._experiment is not None:
            self.experiment.finish(exit_code=status)
