"""Terms as the code of the paper's authors computes them, where it differs from the printed equations.

Code: https://github.com/camillebnm/neural_shape_morphing
"""

from __future__ import annotations

import math

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from nsm.losses.base import Term
from nsm.losses.divergence import Compression
from nsm.losses.evaluation import BatchEvaluation
from nsm.losses.smoothness import Smoothness


class OfficialDirichlet(Term):
    """(f − g) e^{−f²/2} on and around the end shapes: squared, the weight e^{−f²} decays away from the surface."""

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        known = slice(0, evaluation.batch.ambient.stop)
        value = evaluation.f.value[known]
        return (value - evaluation.batch.distances[known]) * (-value.square() / 2).exp()


class OfficialNeumann(Term):
    """1 − cos ∠(∇f, ∇g) at all points where g is known: on the end shapes and around them."""

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        known = evaluation.known_gradients
        return 1 - F.cosine_similarity(evaluation.f.gradient[: len(known), : evaluation.dim], known, dim=1)


class OfficialSmoothness(Smoothness):
    """‖γ V − α ΔV‖/√d: the mean over the d components of the squared vector in place of their sum."""

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        return super().residual(evaluation) / math.sqrt(evaluation.dim)


class OfficialDivergence(Compression):
    """div V without its gradient: part of the logged loss, but not minimized."""

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        return super().residual(evaluation).detach()


class DecoupledEikonal(Term):
    """mean (‖∇f‖ − 1)² · mean e^{−f²}: the Eikonal term with the unintended broadcast of the authors' code.

    The code means to weight each squared residual by e^{−f²} at the same point, but multiplies arrays of shape (n, 1)
    and (n,). They broadcast to (n, n), and the mean of that array is the product of the two means. This class computes
    the product directly, without an array of shape (n, n).
    """

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        return (evaluation.slope - 1) * (-evaluation.f.value.square()).exp().mean().sqrt()
