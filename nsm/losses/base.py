"""Weighted loss terms, their modifiers, and their sum."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import reduce

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.losses.evaluation import BatchEvaluation


class Term(ABC):
    """A loss term, weight · mean |residual|^power, averaged over the points where the residual is defined.

    Args:
        weight: Weight λ of the term.
        power: Exponent of the residual: 2 for squared, 1 for absolute residuals.
    """

    def __init__(self, weight: float, power: float = 2.0) -> None:
        self.weight, self.power = float(weight), float(power)

    @abstractmethod
    def residual(self, evaluation: BatchEvaluation) -> Float[Tensor, " m"]:
        """Compute the residual at the m points where it is defined."""

    def __call__(self, evaluation: BatchEvaluation) -> Float[Tensor, ""]:
        """Compute the weighted term."""
        residual = self.residual(evaluation)
        return self.weight * (residual.square() if self.power == 2 else residual.abs().pow(self.power)).mean()


class OverBatch:
    """A term averaged over *all* points of the batch, with zero residual where it is not defined.

    The code of the paper's authors averages in this way.

    Args:
        term: The term.
    """

    def __init__(self, term: Term) -> None:
        self.term = term

    def __call__(self, evaluation: BatchEvaluation) -> Float[Tensor, ""]:
        """Compute the term, times the fraction of the batch where it is defined."""
        defined = len(self.term.residual(evaluation))
        return self.term(evaluation) * (defined / len(evaluation.batch.points))


class Everywhere:
    """A term of interior points applied to *all* points of the batch, also those on and around the end shapes.

    The code of the paper's authors evaluates its equations in this way.

    Args:
        term: A term defined at interior points, such as `nsm.losses.LevelSet`.
    """

    def __init__(self, term: Term) -> None:
        self.term = term

    def __call__(self, evaluation: BatchEvaluation) -> Float[Tensor, ""]:
        """Compute the term with all points counted as interior points."""
        return self.term(evaluation.everywhere)


class Ramp:
    """A term whose weight grows linearly during training, from zero at ``start`` to its full value at ``stop``.

    Args:
        term: The term.
        start, stop: Fractions of training at which the weight starts and stops growing, 0 ≤ start < stop ≤ 1.

    Raises:
        InputError: If ``start`` and ``stop`` are out of order or not fractions.
    """

    def __init__(self, term: Term | OverBatch, start: float, stop: float) -> None:
        if not 0 <= start < stop <= 1:
            raise InputError(
                f"`start` and `stop` must be fractions of training in increasing order, got {start} and {stop}. Try "
                "`start=0.1` and `stop=0.5`."
            )
        self.term, self.start, self.stop = term, float(start), float(stop)

    def __call__(self, evaluation: BatchEvaluation) -> Float[Tensor, ""]:
        """Compute the term at the present fraction of its weight."""
        fraction = min(max((evaluation.progress - self.start) / (self.stop - self.start), 0.0), 1.0)
        return fraction * self.term(evaluation)


class WeightedSum:
    """The sum of named loss terms.

    Args:
        terms: Terms by name; a term maps a `BatchEvaluation` to a scalar.

    Example:
        >>> import torch
        >>> from nsm.fields import ScalarSiren
        >>> from nsm.losses import BatchEvaluation, Eikonal, SurfaceDirichlet, WeightedSum
        >>> from nsm.sampling import Batch
        >>> batch = Batch(points=torch.rand(8, 4), distances=torch.zeros(4), normals=torch.rand(4, 3))
        >>> evaluation = BatchEvaluation(batch, ScalarSiren(in_features=4, hidden_features=16, hidden_layers=2))
        >>> loss = WeightedSum({"eikonal": Eikonal(weight=100), "surface": SurfaceDirichlet(weight=5e3)})
        >>> total, values = loss(evaluation)
        >>> bool(total == values["eikonal"] + values["surface"])
        True
    """

    def __init__(self, terms: Mapping[str, Callable[[BatchEvaluation], Tensor]]) -> None:
        self.terms = dict(terms)

    def __call__(self, evaluation: BatchEvaluation) -> tuple[Float[Tensor, ""], dict[str, Tensor]]:
        """Compute the sum, and each weighted term by name, detached from the graph."""
        values = {name: term(evaluation) for name, term in self.terms.items()}
        return reduce(torch.add, values.values()), {name: value.detach() for name, value in values.items()}
