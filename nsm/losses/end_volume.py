"""The volume that f encloses at both ends."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.losses.base import Term
from nsm.losses.evaluation import BatchEvaluation


class EndVolume(Term):
    """The mean of f over each end surface, which to first order is the error of the enclosed volume.

    A surface displaced by f/‖∇f‖ changes the volume by the integral of that displacement. `SurfaceDirichlet` bounds its
    size; this term removes its mean, for example where edges are rounded off. The residual has two entries, one for
    each end.
    """

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, 2]:
        surface = evaluation.batch.surface
        value, time = evaluation.f.value[surface], evaluation.batch.points[surface, -1]
        return torch.stack([value[end].mean() for end in (time < 0.5, time >= 0.5)])
