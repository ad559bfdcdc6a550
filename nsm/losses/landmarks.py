"""Landmarks advected by V."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.losses.base import Term
from nsm.losses.evaluation import BatchEvaluation
from nsm.shapes.landmarks import LandmarkPairs

#: Number of cycles through the landmarks in a training. A fractional part near the golden ratio spreads the subsets of
#: successive steps over the list, for any usual number of steps.
_CYCLES = 6180.34


class LandmarkMatch(Term):
    """Distance between landmarks of the source, advected by V from t = 0 to t = 1, and those of the target.

    The options of ``conf/landmarks`` add this term to a loss. Advection uses the classical Runge-Kutta method of order
    4, and the loss differentiates through it. If there are more than ``count`` landmarks, each step uses a subset.

    Args:
        weight, power: See `Term`.
        steps: Number of Runge-Kutta steps from t = 0 to t = 1.
        count: Maximum number of landmarks in a training step.

    References:
        Sang et al., Implicit Neural Surface Deformation with Explicit Velocity Fields, ICLR 2025.
        https://arxiv.org/abs/2501.14038
    """

    def __init__(self, weight: float, power: float = 2.0, steps: int = 8, count: int = 500) -> None:
        super().__init__(weight, power)
        self.steps, self.count = int(steps), int(count)

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        if evaluation.landmarks is None:
            raise InputError(
                "`landmarks` must be set for this loss, got none. Try `landmarks=table landmarks.path=FILE.csv`, "
                "`landmarks=vertices`, or `method=lf_insd`, which needs none."
            )
        x, target = self._subset(evaluation.landmarks, evaluation.progress)
        step = 1 / self.steps
        for number in range(self.steps):
            t = number * step
            first = self._velocity(evaluation, x, t)
            second = self._velocity(evaluation, x + step / 2 * first, t + step / 2)
            third = self._velocity(evaluation, x + step / 2 * second, t + step / 2)
            fourth = self._velocity(evaluation, x + step * third, t + step)
            x = x + step / 6 * (first + 2 * second + 2 * third + fourth)
        return (x - target).norm(dim=1)

    def _subset(self, landmarks: LandmarkPairs, progress: float) -> LandmarkPairs:
        """Choose landmarks spread over the list by progress alone, so that a resumed run chooses the same ones."""
        source, target = landmarks
        total = len(source)
        if total > self.count:
            first = int(progress * _CYCLES % 1 * total)
            chosen = (first + torch.arange(self.count, device=source.device) * (total // self.count)) % total
            source, target = source[chosen], target[chosen]
        return LandmarkPairs(source, target)

    @staticmethod
    def _velocity(evaluation: BatchEvaluation, x: Float[Tensor, "m d"], t: float) -> Float[Tensor, "m d"]:
        return evaluation.velocity_at(torch.cat([x, torch.full_like(x[:, :1], t)], 1))
