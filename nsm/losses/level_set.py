"""The level-set equation (paper, eqs 1 and 10), and its modification that preserves distances."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from nsm.losses.base import Term
from nsm.losses.evaluation import BatchEvaluation


class LevelSet(Term):
    """∂f/∂t + ⟨∇f, V⟩ at interior points: V advects all level sets of f.

    The sign is that of eq. 1. Equation 10 is printed with a minus, which is a misprint.
    """

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        gradient, dim = evaluation.interior.gradient, evaluation.dim
        return gradient[:, dim] + (gradient[:, :dim] * evaluation.velocity).sum(1)


class ModifiedLevelSet(Term):
    """∂f/∂t + ⟨∇f, V⟩ + λ f R at interior points, where R = −⟨(∇V) n, n⟩ and n = ∇f/‖∇f‖.

    With λ = 1 the solution keeps ‖∇f‖ constant on the moving surface.

    Args:
        weight, power: See `Term`.
        relaxation: Factor λ; 0 gives the level-set equation.

    References:
        Sang et al., Implicit Neural Surface Deformation with Explicit Velocity Fields, ICLR 2025.
        https://arxiv.org/abs/2501.14038
    """

    def __init__(self, weight: float, power: float = 2.0, relaxation: float = 1.0) -> None:
        super().__init__(weight, power)
        self.relaxation = float(relaxation)

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        (velocity, jacobian), _ = evaluation.velocity_jet_and_laplacian
        value, gradient = evaluation.interior
        spatial = gradient[:, : evaluation.dim]
        normal = F.normalize(spatial, dim=1)
        stretching = -torch.einsum("ni,nij,nj->n", normal, jacobian, normal)
        rate = gradient[:, evaluation.dim] + (spatial * velocity).sum(1)
        return rate + self.relaxation * value * stretching
