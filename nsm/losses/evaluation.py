"""The networks evaluated at the points of a batch."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.fields.scalar import ScalarNetwork
from nsm.fields.velocity import Velocity
from nsm.sampling.batch import Batch
from nsm.sampling.moving import nearest_key
from nsm.shapes.base import FieldShape
from nsm.shapes.landmarks import LandmarkPairs
from nsm.types import Jet, Key, VectorJet


class BatchEvaluation:
    """Values and derivatives of f and V at the points of a batch, each computed on first use and shared by all terms.

    Args:
        batch: Points with their targets.
        field: The network f(x, t), or f(x) when fitting a still shape.
        velocity: The velocity V, or None for a method or a shape without one.
        landmarks: Corresponding points of source and target, or None.
        progress: Fraction of training that has passed, in [0, 1].
        keys: The shapes that the morph passes through, for terms that need more than the targets of the batch.

    Example:
        >>> import torch
        >>> from nsm.fields import ScalarSiren
        >>> from nsm.losses import BatchEvaluation, Eikonal
        >>> from nsm.sampling import Batch
        >>> field = ScalarSiren(in_features=4, hidden_features=16, hidden_layers=2)
        >>> batch = Batch(points=torch.rand(8, 4), distances=torch.zeros(0), normals=torch.zeros(0, 3))
        >>> evaluation = BatchEvaluation(batch, field)
        >>> torch.equal(Eikonal(weight=1.0).residual(evaluation), evaluation.slope - 1)
        True
    """

    def __init__(
        self,
        batch: Batch,
        field: ScalarNetwork,
        velocity: Velocity | None = None,
        landmarks: LandmarkPairs | None = None,
        progress: float = 1.0,
        keys: Sequence[Key[FieldShape]] = (),
    ) -> None:
        self.batch, self.field, self._velocity = batch, field, velocity
        self.landmarks, self.progress, self._keys = landmarks, progress, keys
        self.dim = batch.normals.shape[1]

    @cached_property
    def f(self) -> Jet:
        """Value, shape (n,), and gradient, shape (n, k), of f at all points of the batch."""
        return self.field.jet(self.batch.points)

    @cached_property
    def slope(self) -> Float[Tensor, " n"]:
        """Norm of the spatial gradient, ‖∇f‖, at all points of the batch."""
        return self.f.gradient[:, : self.dim].norm(dim=1)

    @cached_property
    def interior(self) -> Jet:
        """Value and gradient of f at the interior points."""
        return Jet(*(part[self.batch.interior] for part in self.f))

    @cached_property
    def everywhere(self) -> BatchEvaluation:
        """An evaluation at the same points, all of them counted as interior points.

        It shares the jet of f and has neither targets nor end shapes.
        """
        batch = Batch(self.batch.points, self.batch.distances[:0], self.batch.normals[:0])
        evaluation = BatchEvaluation(batch, self.field, self._velocity, self.landmarks, self.progress)
        evaluation.f = self.f
        return evaluation

    @cached_property
    def known_gradients(self) -> Float[Tensor, "m d"]:
        """Gradients ∇g of the shapes: unit normals at surface points, then gradients at ambient points."""
        if not self._keys:
            raise ValueError("`keys` must be the shapes of the morph for this loss term, got none. Try `morph.keys`.")
        x, t = self.batch.points[self.batch.ambient].tensor_split([self.dim], dim=1)
        gradients, of = torch.empty_like(x), nearest_key(t[:, 0], self._keys)
        for number, key in enumerate(self._keys):
            gradients[of == number] = key.shape.jet(x[of == number]).gradient
        return torch.cat([self.batch.normals, gradients])

    @cached_property
    def velocity(self) -> Float[Tensor, "m d"]:
        """Velocities V at the interior points."""
        return self._required_velocity()(self.batch.points[self.batch.interior], self.interior)

    @cached_property
    def divergence(self) -> Float[Tensor, " m"]:
        """Divergences div V at the interior points."""
        return self._required_velocity().divergence(self.batch.points[self.batch.interior], self.interior)

    @cached_property
    def velocity_jet_and_laplacian(self) -> tuple[VectorJet, Float[Tensor, "m d"]]:
        """V with its spatial Jacobian, and ΔV, at the interior points.

        Raises:
            InputError: If the velocity has no closed-form second derivatives.
        """
        return self._required_velocity().jet_and_laplacian(self.batch.points[self.batch.interior])

    def velocity_at(self, p: Float[Tensor, "n k"]) -> Float[Tensor, "n d"]:
        """Evaluate V at points (x, t) outside the batch, shape (n, d + 1)."""
        return self._required_velocity()(p, self.field.jet(p))

    def _required_velocity(self) -> Velocity:
        if self._velocity is None:
            raise InputError(
                "`velocity` must be set for a loss term that contains V, got none. Try `velocity=adadiv`, or remove "
                "the term."
            )
        return self._velocity
