"""Terms as the authors' code computes them, where that differs from the paper's equations."""

from __future__ import annotations

from torch import Tensor

from nsm.losses.base import Evaluation, Term


class OfficialDirichlet(Term):
    """f = g on and around the end shapes, the squared residual times exp(−f²), which lets go far from the surface."""

    def residual(self, evaluation: Evaluation) -> Tensor:
        known = slice(0, evaluation.batch.ambient.stop)
        value = evaluation.f.value[known]
        return (value - evaluation.batch.distances[known]) * (-value.square() / 2).exp()


class DecoupledEikonal(Term):
    """The Eikonal term with its defect: mean (‖∇f‖ − 1)² · mean exp(−f²).

    Each squared residual was meant to be weighted by exp(−f²) at its own point. The code multiplies an (n, 1) by an
    (n,) array, which broadcasts to n × n, and the mean over that is the product of the two means: the weight no
    longer knows where the residual is. It is computed here as that product, with nothing of size n × n.
    """

    def residual(self, evaluation: Evaluation) -> Tensor:
        return (evaluation.slope - 1) * (-evaluation.f.value.square()).exp().mean().sqrt()
