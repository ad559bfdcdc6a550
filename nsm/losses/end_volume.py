"""The volume that f encloses where it must equal a shape."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.losses.base import Term
from nsm.losses.evaluation import BatchEvaluation


class EndVolume(Term):
    """The mean of f over the surface of each shape, which to first order is the error of the enclosed volume.

    A surface displaced by f/‖∇f‖ changes the volume by the integral of that displacement. `SurfaceDirichlet` bounds its
    size; this term removes its mean, for example where edges are rounded off. The residual has one entry for each
    shape that the morph passes through.
    """

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " k"]:
        surface = evaluation.batch.surface
        value, time = evaluation.f.value[surface], evaluation.batch.points[surface, -1]
        return torch.stack([value[time == key].mean() for key in time.unique()])
