"""Terms of implicit neural surface deformation (Sang et al., ICLR 2025)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from nsm import calculus
from nsm.cli.errors import InputError
from nsm.losses.base import Evaluation, Term
from nsm.shapes.landmarks import LandmarkPairs

#: How often a training goes round the landmarks; not a whole number of times in any round number of steps.
_TURNS = 6180.34


class ModifiedLevelSet(Term):
    """∂f/∂t + ⟨∇f, V⟩ = −λ f R with R = −⟨(∇V) n, n⟩, n = ∇f/‖∇f‖: with λ = 1, ‖∇f‖ is kept on the moving surface.

    Args:
        weight, power: see `Term`.
        relaxation: λ; 0 is the level-set equation itself.
    """

    def __init__(self, weight: float, power: float = 2.0, relaxation: float = 1.0) -> None:
        super().__init__(weight, power)
        self.relaxation = float(relaxation)

    def residual(self, evaluation: Evaluation) -> Tensor:
        (velocity, jacobian), _ = evaluation.motion
        value, gradient = evaluation.interior
        spatial = gradient[:, : evaluation.dim]
        normal = F.normalize(spatial, dim=1)
        stretching = -torch.einsum("ni,nij,nj->n", normal, jacobian, normal)
        rate = gradient[:, evaluation.dim] + (spatial * velocity).sum(1)
        return rate + self.relaxation * value * stretching


class Smoothness(Term):
    """‖γ V − α ΔV‖ = 0: a velocity that bends little.

    Args:
        weight, power: see `Term`.
        alpha: α, in length².
        gamma: γ.
    """

    def __init__(self, weight: float, power: float = 2.0, alpha: float = 0.01, gamma: float = 1.0) -> None:
        super().__init__(weight, power)
        self.alpha, self.gamma = float(alpha), float(gamma)

    def residual(self, evaluation: Evaluation) -> Tensor:
        (velocity, _), laplacian = evaluation.motion
        return (self.gamma * velocity - self.alpha * laplacian).norm(dim=1)


class Compression(Term):
    """div V = 0, asked for softly, from the Jacobian that the modified level-set equation takes anyway."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        (_, jacobian), _ = evaluation.motion
        return calculus.divergence(jacobian)


class LandmarkMatch(Term):
    """Landmarks of the source, carried by V from t = 0 to t = 1, arrive at those of the target.

    They are carried by the classical Runge-Kutta method, with its gradient. Of many landmarks each step takes some, in
    turn.

    Args:
        weight, power: see `Term`.
        steps: of the method from 0 to 1.
        count: landmarks at once.
    """

    def __init__(self, weight: float, power: float = 2.0, steps: int = 8, count: int = 500) -> None:
        super().__init__(weight, power)
        self.steps, self.count = int(steps), int(count)

    def residual(self, evaluation: Evaluation) -> Tensor:
        if evaluation.landmarks is None:
            raise InputError(
                "this loss needs landmarks, and none are given: choose landmarks=table landmarks.path=FILE.csv, or "
                "landmarks=vertices, or method=lf_insd, which needs none"
            )
        x, target = self._some(evaluation.landmarks, evaluation.progress)
        step = 1 / self.steps
        for number in range(self.steps):
            t = number * step
            first = self._velocity(evaluation, x, t)
            second = self._velocity(evaluation, x + step / 2 * first, t + step / 2)
            third = self._velocity(evaluation, x + step / 2 * second, t + step / 2)
            fourth = self._velocity(evaluation, x + step * third, t + step)
            x = x + step / 6 * (first + 2 * second + 2 * third + fourth)
        return (x - target).norm(dim=1)

    def _some(self, landmarks: LandmarkPairs, progress: float) -> LandmarkPairs:
        """Landmarks spread over their list, chosen by the progress alone: a resumed run takes the same."""
        source, target = landmarks
        total = len(source)
        if total > self.count:
            first = int(progress * _TURNS % 1 * total)
            chosen = (first + torch.arange(self.count, device=source.device) * (total // self.count)) % total
            source, target = source[chosen], target[chosen]
        return LandmarkPairs(source, target)

    @staticmethod
    def _velocity(evaluation: Evaluation, x: Tensor, t: float) -> Tensor:
        return evaluation.moved(torch.cat([x, torch.full_like(x[:, :1], t)], 1))
