"""Base of the training tasks: one loss, one optimizer, one schedule."""

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
    """Failure of training: a loss is no longer finite, or the surface has vanished."""


class FieldTask(L.LightningModule):
    """Minimizes a weighted sum of terms over batches of points.

    Args:
        loss: Weighted terms.
        optimizer: Factory of the optimizer, called with the parameters.
        scheduler: Factory of the schedule, called with the optimizer and ``total_steps``.
    """

    def __init__(
        self,
        loss: WeightedSum,
        optimizer: Callable[..., Optimizer],
        scheduler: Callable[..., LRScheduler],
    ) -> None:
        super().__init__()
        self.loss, self.optimizer, self.scheduler = loss, optimizer, scheduler
        #: Factor of every learning rate; lowered after a collapse.
        self.step_scale = 1.0
        #: The loss and its terms at the last step, by the names in the log.
        self.latest: dict[str, Tensor] = {}
        #: Entry that makes a checkpoint describe itself (`nsm.io.checkpoint.describe`).
        self.description: dict[str, Any] = {}

    def evaluation(self, batch: Batch) -> BatchEvaluation:
        """Evaluate the networks at the points of a batch."""
        raise NotImplementedError

    def learn_from(self, evaluation: BatchEvaluation) -> None:
        """Keep what the next batch needs from an evaluation; nothing by default."""

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """Compute the loss, and keep it and its terms in ``latest``."""
        evaluation = self.evaluation(batch)
        total, terms = self.loss(evaluation)
        # processes that train together step back together
        if not self.trainer.strategy.reduce_boolean_decision(bool(torch.isfinite(total))):
            broken = [name for name, value in terms.items() if not torch.isfinite(value)] or ["of another process"]
            raise Collapse(f"the loss {', '.join(broken)} is not finite at step {self.global_step}")
        self.latest = {f"train/{name}": value for name, value in terms.items()} | {"train/loss": total.detach()}
        self.learn_from(evaluation)
        return total

    def on_train_batch_end(self, outputs: Any, batch: Batch, index: int) -> None:
        """Log the terms where a row is written, and stop at the last step, so that it is validated.

        Logging at every step would take a noticeable part of it, although Lightning writes a row only every
        ``log_every_n_steps``.
        """
        if self.global_step >= self.trainer.max_steps:
            self.trainer.should_stop = True
        every = self.trainer.log_every_n_steps  # type: ignore[attr-defined]
        if every and (self.global_step % every == 0 or self.trainer.should_stop):
            self.log_dict(self.latest)

    def configure_optimizers(self) -> Any:
        """Make one optimizer of all parameters, so that one step updates every network."""
        optimizer = self.optimizer([p for p in self.parameters() if p.requires_grad])
        schedule = self.scheduler(optimizer, total_steps=self.trainer.max_steps)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add the description of the networks to the checkpoint."""
        checkpoint[ENTRY] = self.description

    def on_train_start(self) -> None:
        """Lower the learning rates, where training continues after a collapse."""
        for optimizer in self.trainer.optimizers:
            for group in optimizer.param_groups:
                group["lr"] *= self.step_scale
        for config in self.trainer.lr_scheduler_configs:
            config.scheduler.base_lrs = [rate * self.step_scale for rate in config.scheduler.base_lrs]
