"""Ctrl-C and kill: finish the step, keep it, stop; or leave at once where there is nothing to keep."""

from __future__ import annotations

import signal
from abc import ABC, abstractmethod
from types import FrameType
from typing import Any

import lightning as L


class _OnSignal(L.Callback, ABC):
    """Takes over SIGINT and SIGTERM while training runs, in place of Lightning, which then exits with status 1 or 0."""

    def __init__(self) -> None:
        self._before: dict[signal.Signals, Any] = {}

    @abstractmethod
    def receive(self, number: signal.Signals) -> None:
        """What to do; the signals have been given back already, so a second one acts as usual."""

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Take over the signals."""

        def act(number: int, frame: FrameType | None) -> None:
            self._give_back()
            self.receive(signal.Signals(number))

        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, act)

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Give the signals back."""
        self._give_back()

    def on_exception(self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException) -> None:
        """Give the signals back."""
        self._give_back()

    def _give_back(self) -> None:
        while self._before:
            signal.signal(*self._before.popitem())


class StopOnSignal(_OnSignal):
    """Stops training between two steps on SIGINT or SIGTERM, so that the checkpoint written at its end is whole.

    A second Ctrl-C interrupts at once.

    Attributes:
        received: the signal that stopped training, or None.
    """

    def __init__(self) -> None:
        super().__init__()
        self.received: signal.Signals | None = None

    def receive(self, number: signal.Signals) -> None:
        """Remember the signal until the step is complete."""
        self.received = number

    def on_train_batch_end(
        self, trainer: L.Trainer, pl_module: L.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Stop where an optimiser step is complete, and no gradient of a further batch is waiting."""
        if self.received and (batch_idx + 1) % trainer.accumulate_grad_batches == 0:
            trainer.should_stop = True


class ExitOnSignal(_OnSignal):
    """Ends the program on SIGINT or SIGTERM with the usual status, 130 or 143: for training that keeps nothing."""

    def receive(self, number: signal.Signals) -> None:
        """Leave."""
        raise SystemExit(128 + number)
