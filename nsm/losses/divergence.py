"""Penalties on the divergence of V (paper, eq. 4)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from nsm import calculus
from nsm.losses.base import Term
from nsm.losses.evaluation import BatchEvaluation


class Divergence(Term):
    """div V at interior points, for any velocity."""

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        return evaluation.divergence


class Compression(Term):
    """div V at interior points, from the Jacobian that `ModifiedLevelSet` and `Smoothness` compute anyway."""

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        (_, jacobian), _ = evaluation.velocity_jet_and_laplacian
        return calculus.divergence(jacobian)
