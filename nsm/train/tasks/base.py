"""What the training tasks share: one loss, one optimiser, one schedule."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import lightning as L
import torch
from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from nsm.io.checkpoint import ENTRY
from nsm.losses import BatchEvaluation, WeightedSum
from nsm.sampling import Batch


class Collapse(RuntimeError):
    """Training went astray: a loss is no longer finite, or the shape has vanished."""


class FieldTask(L.LightningModule):
    """Minimises a weighted sum of terms over batches of points.

    Args:
        loss: the terms.
        optimizer: makes the optimiser, called with the parameters.
        scheduler: makes the schedule, called with the optimiser and ``total_steps``.
    """

    def __init__(
        self,
        loss: WeightedSum,
        optimizer: Callable[..., Optimizer],
        scheduler: Callable[..., LRScheduler],
    ) -> None:
        super().__init__()
        self.loss, self.optimizer, self.scheduler = loss, optimizer, scheduler
        #: Lowered after a collapse; multiplies every learning rate from the step where training goes on.
        self.step_scale = 1.0
        #: The loss and its terms at the last step, under the names by which they are logged.
        self.latest: dict[str, Tensor] = {}
        #: Entry that makes a checkpoint describe itself (`nsm.io.checkpoint.describe`).
        self.description: dict[str, Any] = {}

    def evaluation(self, batch: Batch) -> BatchEvaluation:
        """The networks at the points of a batch."""
        raise NotImplementedError

    def learn_from(self, evaluation: BatchEvaluation) -> None:
        """Take from an evaluation what the next batch needs; nothing by default."""

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """One loss; it and its terms are kept in ``latest``."""
        evaluation = self.evaluation(batch)
        total, terms = self.loss(evaluation)
        if not torch.isfinite(total):
            broken = [name for name, value in terms.items() if not torch.isfinite(value)]
            raise Collapse(f"the loss {', '.join(broken)} is not finite at step {self.global_step}")
        self.latest = {f"train/{name}": value for name, value in terms.items()} | {"train/loss": total.detach()}
        self.learn_from(evaluation)
        return total

    def on_train_batch_end(self, outputs: Any, batch: Batch, index: int) -> None:
        """Log the terms where a row is written, and let the last step be validated, wherever it lies.

        Lightning takes a noticeable part of a step to note values that it then writes every ``log_every_n_steps`` only.
        """
        if self.global_step >= self.trainer.max_steps:
            self.trainer.should_stop = True
        every = self.trainer.log_every_n_steps  # type: ignore[attr-defined]
        if every and (self.global_step % every == 0 or self.trainer.should_stop):
            self.log_dict(self.latest)

    def configure_optimizers(self) -> Any:
        """One optimiser for all parameters, so that one step moves every network at once."""
        optimizer = self.optimizer([p for p in self.parameters() if p.requires_grad])
        schedule = self.scheduler(optimizer, total_steps=self.trainer.max_steps)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Let the checkpoint describe itself."""
        checkpoint[ENTRY] = self.description

    def on_train_start(self) -> None:
        """Apply a smaller step, where training goes on after a collapse."""
        for optimizer in self.trainer.optimizers:
            for group in optimizer.param_groups:
                group["lr"] *= self.step_scale
        for config in self.trainer.lr_scheduler_configs:
            config.scheduler.base_lrs = [rate * self.step_scale for rate in config.scheduler.base_lrs]
