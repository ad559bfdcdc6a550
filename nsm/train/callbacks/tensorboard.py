"""Runs of training in TensorBoard."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from lightning.fabric.utilities.logger import _flatten_dict, _sanitize_params
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.utilities.rank_zero import rank_zero_only
from omegaconf import OmegaConf
from torch import Tensor

from nsm.cli.extras import require
from nsm.io.palette import CLAY
from nsm.metrics import VolumeCurve
from nsm.morphs.surfaces import Frame
from nsm.plots.curves import VOLUME_COLUMNS, volume_rows
from nsm.train.callbacks.tracker import Tracker


class TensorBoardLog(TensorBoardLogger, Tracker):
    """Logs curves, tables, pictures, surfaces, and hyperparameters for TensorBoard, which the extra ``track`` installs.

    TensorBoard stores no files, so the checkpoint stays in the run's folder.

    Args:
        arguments: Those of `lightning.pytorch.loggers.TensorBoardLogger`.

    Raises:
        MissingPackageError: If TensorBoard is not installed.
    """

    def __init__(self, **arguments: Any) -> None:
        require("tensorboard", extra="track", task="`logger=tensorboard`")
        # TensorBoard's own hyperparameters are written with the outcome, since they need figures to compare
        super().__init__(default_hp_metric=False, **arguments)
        self._config: Mapping[str, Any] = {}

    @rank_zero_only
    def begin(self, config: Mapping[str, Any], group: str | None) -> None:
        # groups of runs are folders, which the runs are in already
        self._config = config
        text = OmegaConf.to_yaml(OmegaConf.create(dict(config)))
        self.experiment.add_text("config", "\n".join(f"    {line}" for line in text.splitlines()), 0)

    @rank_zero_only
    def rewind(self, step: int) -> None:
        from tensorboard.compat.proto.event_pb2 import Event, SessionLog

        # readers drop all earlier events from this step on
        event = Event(step=step, session_log=SessionLog(status=SessionLog.START))
        self.experiment._get_file_writer().add_event(event, step)

    def picture(self, name: str, file: Path, step: int) -> None:
        self.experiment.add_image(name, _pixels(file), step, dataformats="HWC")

    def curve(self, name: str, curve: VolumeCurve, step: int) -> None:
        rows = [list(VOLUME_COLUMNS), ["---:"] * len(VOLUME_COLUMNS)]
        rows += [[f"{number:.6g}" for number in row] for row in volume_rows(curve.times, curve.volumes)]
        self.experiment.add_text(name, "\n".join(f"| {' | '.join(row)} |" for row in rows), step)

    def surface(self, name: str, frame: Frame, step: int) -> None:
        vertices, faces = (part.cpu()[None] for part in frame.mesh)
        if vertices.numel():
            clay = (255 * torch.tensor(CLAY)).round().int().expand_as(vertices)
            self.experiment.add_mesh(name, vertices.float(), clay, faces, global_step=step)

    def outcome(self, figures: Mapping[str, float], checkpoint: Path, step: int) -> None:
        from torch.utils.tensorboard.summary import hparams

        settings = _sanitize_params(_flatten_dict(dict(self._config), delimiter="."))
        for summary in hparams(settings, dict(figures)):
            self.experiment._get_file_writer().add_summary(summary, step)
        for name, value in figures.items():
            self.experiment.add_scalar(name, value, step)

    def close(self, status: int) -> None:
        self.finalize("success" if status == 0 else "failed")


def _pixels(picture: Path) -> Tensor:
    from matplotlib.image import imread

    return torch.from_numpy(imread(picture)[..., :3].copy())
