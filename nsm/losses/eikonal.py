"""The Eikonal equation (paper, eqs 2 and 11)."""

from __future__ import annotations

from torch import Tensor

from nsm.losses.base import Evaluation, Term


class Eikonal(Term):
    """‖∇f‖ = 1 at every point and time of the batch: f is a distance throughout."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        return evaluation.slope - 1


class EndEikonal(Term):
    """‖∇f‖ = 1 on and around the end shapes alone, at t = 0 and 1: on the way f is free."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        return evaluation.slope[: evaluation.batch.ambient.stop] - 1
