"""Terms as the authors' code computes them, where that differs from the paper's equations."""

from __future__ import annotations

import math

import torch.nn.functional as F
from torch import Tensor

from nsm.losses.base import Evaluation, Term
from nsm.losses.insd import Compression, Smoothness


class OfficialDirichlet(Term):
    """f = g on and around the end shapes, the squared residual times exp(−f²), which lets go far from the surface."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        known = slice(0, evaluation.batch.ambient.stop)
        value = evaluation.f.value[known]
        return (value - evaluation.batch.distances[known]) * (-value.square() / 2).exp()


class OfficialNeumann(Term):
    """1 − cos(∇f, ∇g) at every point where g is known: on the end shapes and around them."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        known = evaluation.known_gradients
        return 1 - F.cosine_similarity(evaluation.f.gradient[: len(known), : evaluation.dim], known, dim=1)


class OfficialSmoothness(Smoothness):
    """‖γ V − α ΔV‖/√d: squared, the mean over the d components of the vector, not the sum."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        return super().residual(evaluation) / math.sqrt(evaluation.dim)


class OfficialDivergence(Compression):
    """div V without its gradient, as the authors' code has it: logged, part of the sum, and not minimized."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        return super().residual(evaluation).detach()


class DecoupledEikonal(Term):
    """The Eikonal term with its defect: mean (‖∇f‖ − 1)² · mean exp(−f²).

    Each squared residual was meant to be weighted by exp(−f²) at its own point. The code multiplies an (n, 1) by an
    (n,) array, which broadcasts to n × n, and the mean over that is the product of the two means: the weight no
    longer knows where the residual is. It is computed here as that product, with nothing of size n × n.
    """

    def residual(self, evaluation: Evaluation) -> Tensor:
        return (evaluation.slope - 1) * (-evaluation.f.value.square()).exp().mean().sqrt()
