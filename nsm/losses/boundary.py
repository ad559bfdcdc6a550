"""Attachment of f to the end shapes (paper, eqs 12 and 13)."""

from __future__ import annotations

import torch
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


class EndVolume(Term):
    """The mean of f over each end surface is zero: to first order, f encloses the volume of the end shape.

    A surface that lies off by f/‖∇f‖ changes the volume by the integral of that over it. Errors of both signs cancel
    in a volume; this term takes away what does not, such as edges that are rounded off, and costs two numbers.
    """

    def residual(self, evaluation: Evaluation) -> Tensor:
        surface = evaluation.batch.surface
        value, time = evaluation.f.value[surface], evaluation.batch.points[surface, -1]
        return torch.stack([value[end].mean() for end in (time < 0.5, time >= 0.5)])
