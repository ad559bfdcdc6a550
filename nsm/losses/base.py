"""Losses as named, weighted terms over one evaluation of the networks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import cached_property

import torch
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.fields.scalar import ScalarNetwork
from nsm.fields.velocity import Free, Velocity
from nsm.sampling.batch import Batch
from nsm.shapes.base import FieldShape
from nsm.shapes.landmarks import LandmarkPairs
from nsm.types import Jet, VectorJet


class Evaluation:
    """The networks at the points of a batch: everything that terms ask for, computed once and only if asked for.

    Args:
        batch: the points, with their targets.
        field: f, of (x, t), or of x alone where a still shape is fitted.
        velocity: V, or None where nothing moves.
        landmarks: points of the source and of the target that belong together, or None where none are known.
        progress: how much of the training is over, from 0 to 1.
        ends: the shapes at t = 0 and t = 1, or None where the loss asks for nothing but the targets of the batch.
    """

    def __init__(
        self,
        batch: Batch,
        field: ScalarNetwork,
        velocity: Velocity | None = None,
        landmarks: LandmarkPairs | None = None,
        progress: float = 1.0,
        ends: tuple[FieldShape, FieldShape] | None = None,
    ) -> None:
        self.batch, self.field, self._velocity = batch, field, velocity
        self.landmarks, self.progress, self._ends = landmarks, progress, ends
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
    def everywhere(self) -> Evaluation:
        """The same points, all of them interior points: V and what follows from it are evaluated on every one.

        The jet of f is shared with this evaluation; targets and end shapes are not known there.
        """
        batch = Batch(self.batch.points, self.batch.distances[:0], self.batch.normals[:0])
        evaluation = Evaluation(batch, self.field, self._velocity, self.landmarks, self.progress)
        evaluation.f = self.f
        return evaluation

    @cached_property
    def known_gradients(self) -> Tensor:
        """∇g (s + a, d) of the end shapes: the unit normals at surface points, then the gradients at ambient points."""
        if self._ends is None:
            raise ValueError("this term needs the end shapes, and none are given: pass `ends` to `Evaluation`")
        x, t = self.batch.points[self.batch.ambient].tensor_split([self.dim], dim=1)
        gradients = torch.empty_like(x)
        for shape, here in zip(self._ends, (t[:, 0] < 0.5, t[:, 0] >= 0.5), strict=True):
            gradients[here] = shape.jet(x[here]).gradient
        return torch.cat([self.batch.normals, gradients])

    @cached_property
    def velocity(self) -> Tensor:
        """V (m, d) at the interior points."""
        return self._moving()(self.batch.points[self.batch.interior], self.interior)

    @cached_property
    def divergence(self) -> Tensor:
        """div V (m,) at the interior points."""
        return self._moving().divergence(self.batch.points[self.batch.interior], self.interior)

    @cached_property
    def motion(self) -> tuple[VectorJet, Tensor]:
        """V, its Jacobian and its vector Laplacian (m, d) at the interior points, for a V that is a network itself."""
        velocity = self._moving()
        if not isinstance(velocity, Free):
            raise InputError(
                f"this loss takes second derivatives of the velocity, which {type(velocity).__name__} does not give: "
                "choose velocity=free"
            )
        return velocity.jet_and_laplacian(self.batch.points[self.batch.interior])

    def moved(self, p: Tensor) -> Tensor:
        """V (n, d) at any points p (n, d + 1) of space-time."""
        return self._moving()(p, self.field.jet(p))

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


class Everywhere:
    """A term at *all* points of the batch, those on and around the end shapes included, as the authors' code has it.

    Args:
        term: a term that lives at interior points, such as `nsm.losses.LevelSet`.
    """

    def __init__(self, term: Term) -> None:
        self.term = term

    def __call__(self, evaluation: Evaluation) -> Tensor:
        """The term on the batch whose points all count as interior ones."""
        return self.term(evaluation.everywhere)


class Ramp:
    """A term that comes in during the training: not there at first, then growing evenly to its full weight.

    Args:
        term: the term.
        start, stop: the parts of the training, from 0 to 1, after which it begins to grow, and is in full.

    Raises:
        InputError: if they are not in this order.
    """

    def __init__(self, term: Term | OverBatch, start: float, stop: float) -> None:
        if not 0 <= start < stop <= 1:
            raise InputError(f"a term grows from start={start} to stop={stop}: give two parts of 1, as 0.1 and 0.5")
        self.term, self.start, self.stop = term, float(start), float(stop)

    def __call__(self, evaluation: Evaluation) -> Tensor:
        """The term, times what it has grown to."""
        grown = min(max((evaluation.progress - self.start) / (self.stop - self.start), 0.0), 1.0)
        return grown * self.term(evaluation)


class WeightedSum:
    """The sum of named terms.

    Args:
        terms: name → term; a term is any callable from an `Evaluation` to a scalar.
    """

    def __init__(self, terms: Mapping[str, Callable[[Evaluation], Tensor]]) -> None:
        self.terms = dict(terms)

    def __call__(self, evaluation: Evaluation) -> tuple[Tensor, dict[str, Tensor]]:
        """The sum, with gradient, and each weighted term by name, without."""
        values = {name: term(evaluation) for name, term in self.terms.items()}
        return sum(values.values()), {name: value.detach() for name, value in values.items()}  # type: ignore[return-value]
