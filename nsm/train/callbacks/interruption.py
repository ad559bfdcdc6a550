"""Handling of Ctrl-C and SIGTERM: stop after the current step, or exit at once where nothing is kept."""

from __future__ import annotations

import signal
from abc import ABC, abstractmethod
from types import FrameType
from typing import Any

import lightning as L
import torch


class _OnSignal(L.Callback, ABC):
    """Handles SIGINT and SIGTERM during training; Lightning itself would exit with status 1 or 0."""

    def __init__(self) -> None:
        self._before: dict[signal.Signals, Any] = {}

    @abstractmethod
    def receive(self, number: signal.Signals) -> None:
        """React to a signal; the handlers are restored already, so that a second signal acts as usual."""

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Install the handlers."""

        def act(number: int, frame: FrameType | None) -> None:
            self._restore()
            self.receive(signal.Signals(number))

        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, act)

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Restore the handlers."""
        self._restore()

    def on_exception(self, trainer: L.Trainer, pl_module: L.LightningModule, exception: BaseException) -> None:
        """Restore the handlers."""
        self._restore()

    def _restore(self) -> None:
        while self._before:
            signal.signal(*self._before.popitem())


class StopOnSignal(_OnSignal):
    """Stops training between two steps on SIGINT or SIGTERM, so that the final checkpoint is consistent.

    Processes that train together all stop after the same step, whichever of them received the signal. A second Ctrl-C
    interrupts at once.

    Attributes:
        received: Signal that stopped training, or None.
    """

    def __init__(self) -> None:
        super().__init__()
        self.received: signal.Signals | None = None

    def receive(self, number: signal.Signals) -> None:
        """Note the signal until the step is complete."""
        self.received = number

    def on_train_batch_end(
        self, trainer: L.Trainer, pl_module: L.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Stop where an optimizer step is complete, without gradients of further batches."""
        if (batch_idx + 1) % trainer.accumulate_grad_batches:
            return
        # a signal that arrives during the exchange counts at the next step, when all processes learn of it
        number = float(self.received or 0)
        if trainer.world_size > 1:
            own = torch.tensor(number, device=trainer.strategy.root_device)
            number = float(trainer.strategy.reduce(own, reduce_op="max"))
        if number:
            self.received = signal.Signals(int(number))
            trainer.should_stop = True


class ExitOnSignal(_OnSignal):
    """Exits on SIGINT or SIGTERM with the usual status, 130 or 143, for training that keeps nothing."""

    def receive(self, number: signal.Signals) -> None:
        """Exit."""
        raise SystemExit(128 + number)
