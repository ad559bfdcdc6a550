"""The Eikonal equation (paper, eqs 2 and 11)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from nsm.losses.base import Term
from nsm.losses.evaluation import BatchEvaluation


class Eikonal(Term):
    """‖∇f‖ − 1 at all points and times of the batch, so that f remains a signed distance.

    References:
        Gropp et al., Implicit Geometric Regularization for Learning Shapes, ICML 2020.
        https://arxiv.org/abs/2002.10099
    """

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        return evaluation.slope - 1


class EndEikonal(Term):
    """‖∇f‖ − 1 on and around the end shapes only, at t = 0 and t = 1, as NISE requires."""

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        return evaluation.slope[: evaluation.batch.ambient.stop] - 1
