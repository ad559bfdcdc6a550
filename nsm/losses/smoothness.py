"""The smoothness of V."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from nsm.losses.base import Term
from nsm.losses.evaluation import BatchEvaluation


class Smoothness(Term):
    """‖γ V − α ΔV‖ at interior points, which penalizes fast and strongly curved velocities.

    Args:
        weight, power: See `Term`.
        alpha: Weight α of the vector Laplacian, in length².
        gamma: Weight γ of the velocity.

    References:
        Sang et al., Implicit Neural Surface Deformation with Explicit Velocity Fields, ICLR 2025.
        https://arxiv.org/abs/2501.14038
    """

    def __init__(self, weight: float, power: float = 2.0, alpha: float = 0.01, gamma: float = 1.0) -> None:
        super().__init__(weight, power)
        self.alpha, self.gamma = float(alpha), float(gamma)

    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        (velocity, _), laplacian = evaluation.velocity_jet_and_laplacian
        return (self.gamma * velocity - self.alpha * laplacian).norm(dim=1)
