"""Ctrl-C and kill: finish the step, keep it, stop."""

from __future__ import annotations

import signal
from types import FrameType
from typing import Any

import lightning as L


class StopOnSignal(L.Callback):
    """Stops training between two steps on SIGINT or SIGTERM, so that the checkpoint written at its end is whole.

    A second Ctrl-C interrupts at once.

    Attributes:
        received: the signal that stopped training, or None.
    """

    def __init__(self) -> None:
        self.received: signal.Signals | None = None
        self._before: dict[signal.Signals, Any] = {}

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Take over the signals."""

        def stop(number: int, frame: FrameType | None) -> None:
            self.received = signal.Signals(number)
            self._give_back()

        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, stop)

    def on_train_batch_end(
        self, trainer: L.Trainer, pl_module: L.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Stop where an optimiser step is complete, and no gradient of a further batch is waiting."""
        if self.received and (batch_idx + 1) % trainer.accumulate_grad_batches == 0:
            trainer.should_stop = True

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Give the signals back."""
        self._give_back()

    def on_exception(self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException) -> None:
        """Give the signals back."""
        self._give_back()

    def _give_back(self) -> None:
        while self._before:
            signal.signal(*self._before.popitem())
