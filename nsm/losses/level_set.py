"""The level-set equation (paper, eqs 1 and 10)."""

from __future__ import annotations

from torch import Tensor

from nsm.losses.base import Evaluation, Term


class LevelSet(Term):
    """∂f/∂t + ⟨∇f, V⟩ = 0 in space-time: V carries every level set of f.

    The sign is that of eq. 1; eq. 10 is printed with a minus, a misprint.
    """

    def residual(self, evaluation: Evaluation) -> Tensor:
        gradient = evaluation.interior.gradient
        dim = evaluation.dim
        return gradient[:, dim] + (gradient[:, :dim] * evaluation.velocity).sum(1)
