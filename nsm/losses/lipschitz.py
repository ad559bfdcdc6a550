"""The Lipschitz bound of f."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from nsm.losses.base import Term
from nsm.losses.evaluation import BatchEvaluation


class LipschitzBound(Term):
    """The learned bound on the Lipschitz constant of f, Π_l softplus(c_l).

    References:
        Liu et al., Learning Smooth Neural Functions via Lipschitz Regularization, SIGGRAPH 2022, eq. 7.
        https://arxiv.org/abs/2202.08345
    """

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, 1]:
        return evaluation.field.bound[None]
