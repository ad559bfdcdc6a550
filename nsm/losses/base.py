"""Losses as named, weighted terms over one evaluation of the networks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property

from torch import Tensor

from nsm.fields.siren import ScalarSiren
from nsm.fields.velocity import Velocity
from nsm.sampling.batch import Batch
from nsm.types import Jet


class Evaluation:
    """The networks at the points of a batch: everything that terms ask for, computed once and only if asked for.

    Args:
        batch: the points, with their targets.
        field: f, of (x, t), or of x alone where a still shape is fitted.
        velocity: V, or None where nothing moves.
    """

    def __init__(self, batch: Batch, field: ScalarSiren, velocity: Velocity | None = None) -> None:
        self.batch, self.field, self._velocity = batch, field, velocity
        self.dim = batch.normals.shape[1]

    @cached_property
    def f(self) -> Jet:
        """Value (n,) and gradient (n, k) of f at all points of the batch, in its order."""
        return self.field.jet(self.batch.points)

    @cached_property
    def slope(self) -> Tensor:
        """‖∇f‖ (n,), in space, at all points."""
        return self.f.gradient[:, : self.dim].norm(dim=1)

    @cached_property
    def interior(self) -> Jet:
        """The jet of f at the interior points."""
        return Jet(*(part[self.batch.interior] for part in self.f))

    @cached_property
    def velocity(self) -> Tensor:
        """V (m, d) at the interior points."""
        return self._moving()(self.batch.points[self.batch.interior], self.interior)

    @cached_property
    def divergence(self) -> Tensor:
        """div V (m,) at the interior points."""
        return self._moving().divergence(self.batch.points[self.batch.interior], self.interior)

    def _moving(self) -> Velocity:
        if self._velocity is None:
            raise ValueError("this term needs a velocity field, and a still shape has none: remove the term")
        return self._velocity


class Term(ABC):
    """One weighted term: weight · mean |residual|^power, the mean over the points where the residual is defined.

    Args:
        weight: λ of the term.
        power: 2 for squared residuals, 1 for absolute ones.
    """

    def __init__(self, weight: float, power: float = 2.0) -> None:
        self.weight, self.power = float(weight), float(power)

    @abstractmethod
    def residual(self, evaluation: Evaluation) -> Tensor:
        """The residual (m,) at the points where it is defined."""

    def __call__(self, evaluation: Evaluation) -> Tensor:
        """The weighted term, a scalar."""
        residual = self.residual(evaluation)
        return self.weight * (residual.square() if self.power == 2 else residual.abs().pow(self.power)).mean()


class OverBatch:
    """A term averaged over *all* points of the batch, zero where it is not defined, as the authors' code does."""

    def __init__(self, term: Term) -> None:
        self.term = term

    def __call__(self, evaluation: Evaluation) -> Tensor:
        """The term, times the fraction of the batch where it is defined."""
        defined = len(self.term.residual(evaluation))
        return self.term(evaluation) * (defined / len(evaluation.batch.points))


class WeightedSum:
    """The sum of named terms.

    Args:
        terms: name → term; a term is any callable from an `Evaluation` to a scalar.
    """

    def __init__(self, terms: Mapping[str, Term | OverBatch]) -> None:
        self.terms = dict(terms)

    def __call__(self, evaluation: Evaluation) -> tuple[Tensor, dict[str, Tensor]]:
        """The sum, with gradient, and each weighted term by name, without."""
        values = {name: term(evaluation) for name, term in self.terms.items()}
        return sum(values.values()), {name: value.detach() for name, value in values.items()}  # type: ignore[return-value]
