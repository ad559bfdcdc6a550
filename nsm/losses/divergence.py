"""The divergence penalty (paper, eq. 4)."""

from __future__ import annotations

from torch import Tensor

from nsm.losses.base import Evaluation, Term


class Divergence(Term):
    """div V = 0 in space-time, asked for softly; the gradient reaches V."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        return evaluation.divergence
