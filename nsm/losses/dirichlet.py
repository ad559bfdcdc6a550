"""Dirichlet conditions: f equals the signed distances of the end shapes (paper, eq. 12)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from nsm.losses.base import Term
from nsm.losses.evaluation import BatchEvaluation


class AmbientDirichlet(Term):
    """f − g at points around the end shapes: the first sum of eq. 12."""

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        ambient = evaluation.batch.ambient
        return evaluation.f.value[ambient] - evaluation.batch.distances[ambient]


class SurfaceDirichlet(Term):
    """f on the surfaces of the end shapes: the second sum of eq. 12."""

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        return evaluation.f.value[evaluation.batch.surface]
