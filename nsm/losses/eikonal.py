"""The Eikonal equation (paper, eqs 2 and 11)."""

from __future__ import annotations

from torch import Tensor

from nsm.losses.base import Evaluation, Term


class Eikonal(Term):
    """‖∇f‖ = 1 at every point and time of the batch: f is a distance throughout."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        return evaluation.slope - 1


class SoftEikonal(Term):
    """‖∇f‖ = 1 wherever it can be: the residual r = ‖∇f‖ − 1 is taken as r / √(1 + (r/c)²), never larger than c.

    On the medial axis, and where the topology changes, no distance has a gradient, and a smooth f must break the
    equation. There the squared residual would outweigh what V has to do; bounded (Geman and McClure, 1987), it lets go.

    Args:
        weight: λ of the term.
        bound: c, the residual at which the term begins to let go.
        power: of the bounded residual.
    """

    def __init__(self, weight: float, bound: float = 0.3, power: float = 2.0) -> None:
        super().__init__(weight, power)
        self.bound = float(bound)

    def residual(self, evaluation: Evaluation) -> Tensor:
        residual = evaluation.slope - 1
        return residual / (1 + (residual / self.bound).square()).sqrt()
