"""Neumann conditions: ∇f equals the normals N of the end shapes (paper, eq. 13)."""

from __future__ import annotations

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from nsm.losses.base import Term
from nsm.losses.evaluation import BatchEvaluation


class Neumann(Term):
    """1 − ⟨∇f, N⟩ on the surfaces of the end shapes, as eq. 13 is printed."""

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        return 1 - (_surface_gradient(evaluation) * evaluation.batch.normals).sum(1)


class NormalAlignment(Term):
    """1 − cos ∠(∇f, N) on the surfaces of the end shapes, independent of the length of ∇f."""

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        return 1 - F.cosine_similarity(_surface_gradient(evaluation), evaluation.batch.normals, dim=1)


class NormalMatch(Term):
    """‖∇f − N‖ on the surfaces of the end shapes: direction and length together, quadratic near the solution."""

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        return (_surface_gradient(evaluation) - evaluation.batch.normals).norm(dim=1)


def _surface_gradient(evaluation: BatchEvaluation) -> Float[Tensor, "m d"]:
    return evaluation.f.gradient[evaluation.batch.surface, : evaluation.dim]
