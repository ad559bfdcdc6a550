"""Curves of training for TensorBoard."""

from __future__ import annotations

from typing import Any

from lightning.pytorch.loggers import TensorBoardLogger

from nsm.cli.extras import require


class TensorBoardLog(TensorBoardLogger):
    """Lightning's logger for TensorBoard, which the extra ``track`` installs.

    Args:
        arguments: Those of `lightning.pytorch.loggers.TensorBoardLogger`.

    Raises:
        MissingPackageError: If TensorBoard is not installed.
    """

    def __init__(self, **arguments: Any) -> None:
        require("tensorboard", extra="track", task="`logger=tensorboard`")
        super().__init__(**arguments)
