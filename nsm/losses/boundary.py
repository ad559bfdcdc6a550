"""Attachment of f to the end shapes (paper, eqs 12 and 13)."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor

from nsm.losses.base import Evaluation, Term


class AmbientDirichlet(Term):
    """f = g at points around the end shapes: the first sum of eq. 12."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        ambient = evaluation.batch.ambient
        return evaluation.f.value[ambient] - evaluation.batch.distances[ambient]


class SurfaceDirichlet(Term):
    """f = 0 on the end shapes: the second sum of eq. 12."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        return evaluation.f.value[evaluation.batch.surface]


class Neumann(Term):
    """∇f = N on the end shapes, as 1 − ⟨∇f, N⟩ (eq. 13 as printed)."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        gradient = evaluation.f.gradient[evaluation.batch.surface, : evaluation.dim]
        return 1 - (gradient * evaluation.batch.normals).sum(1)


class NormalAlignment(Term):
    """The angle between ∇f and N on the end shapes, as 1 − cos(∇f, N): blind to the length of ∇f."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        gradient = evaluation.f.gradient[evaluation.batch.surface, : evaluation.dim]
        return 1 - F.cosine_similarity(gradient, evaluation.batch.normals, dim=1)


class NormalMatch(Term):
    """∇f = N on the end shapes, as ‖∇f − N‖: direction and length at once, quadratic near the solution."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        gradient = evaluation.f.gradient[evaluation.batch.surface, : evaluation.dim]
        return (gradient - evaluation.batch.normals).norm(dim=1)
