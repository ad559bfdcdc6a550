"""Training of one shape: a sine network fitted to a mesh, a point cloud, or another field."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from nsm.fields import ScalarSiren
from nsm.losses import BatchEvaluation, WeightedSum
from nsm.sampling import Batch
from nsm.train.tasks.base import FieldTask


class SdfTask(FieldTask):
    """Fits g(x) to points on a surface, their normals, and distances around it.

    Validation logs ``val/error``, the mean distance |g|/‖∇g‖ of g's surface from fixed points of the shape, and
    ``val/normal``, the mean angle of ∇g to the normals there in degrees.

    Args:
        network: Scalar network g of d inputs.
        loss: Weighted terms, none of which may need a velocity.
        optimizer: Factory of the optimizer, see `FieldTask`.
        scheduler: Factory of the schedule, see `FieldTask`.
    """

    def __init__(
        self,
        network: ScalarSiren,
        loss: WeightedSum,
        optimizer: Callable[..., Optimizer],
        scheduler: Callable[..., LRScheduler],
    ) -> None:
        super().__init__(loss, optimizer, scheduler)
        self.network = network

    def evaluation(self, batch: Batch) -> BatchEvaluation:
        """Evaluate g at the points of a batch."""
        return BatchEvaluation(batch, self.network)

    @torch.no_grad()
    def validation_step(self, batch: Batch, index: int) -> Tensor:
        """Measure the distance of the surface and the angle of the normals."""
        jet = self.network.jet(batch.points[batch.surface])
        slope = jet.gradient.norm(dim=1)
        cosine = (jet.gradient * batch.normals).sum(1) / slope
        error = (jet.value.abs() / slope).mean()
        self.log_dict(
            {"val/error": error, "val/normal": torch.rad2deg(torch.acos(cosine.clamp(-1, 1))).mean()},
            batch_size=len(slope),
        )
        return error
