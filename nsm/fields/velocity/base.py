"""The interface of velocity fields V(x, t)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from jaxtyping import Float
from torch import Tensor, nn

from nsm.cli.errors import InputError
from nsm.fields.scalar import ScalarNetwork
from nsm.fields.siren import VectorSiren
from nsm.types import Jet, Key, SignedDistance, VectorJet

#: Builds a network when called with ``in_features`` and ``out_features``.
NetworkFactory = Callable[..., VectorSiren]


class Velocity(nn.Module, ABC):
    """A velocity field V(x, t) that advects the level sets of f.

    Args:
        dim: Dimension d of space.
    """

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.dim = dim

    @property
    def core(self) -> Velocity:
        """The velocity that has a network: this one, or the one that a composition is made of."""
        return self

    def attach(self, field: ScalarNetwork, keys: Sequence[Key[SignedDistance]]) -> None:
        """Pass f and the shapes to a velocity that is computed from them; learned velocities ignore both.

        Args:
            field: The network f(x, t). It stays part of the morph and does not become a submodule here.
            keys: Shapes that the morph passes through, in order of time.

        Raises:
            InputError: If the velocity cannot lead through these shapes.
        """

    @abstractmethod
    def forward(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, "n d"]:
        """Evaluate V.

        Args:
            p: Points (x, t) in space-time, shape (n, d + 1).
            f: Value and gradient of f at these points.

        Returns:
            Velocities, shape (n, d).
        """

    @abstractmethod
    def divergence(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, " n"]:
        """Evaluate the spatial divergence of V in closed form.

        Args:
            p: Points (x, t) in space-time, shape (n, d + 1).
            f: Value and gradient of f at these points.

        Returns:
            Divergences, shape (n,).
        """

    def jet_and_laplacian(self, p: Float[Tensor, "n k"]) -> tuple[VectorJet, Float[Tensor, "n d"]]:
        """Evaluate V, its spatial Jacobian, and its vector Laplacian ΔV in one propagation.

        Args:
            p: Points (x, t) in space-time, shape (n, d + 1).

        Raises:
            InputError: If V has no closed-form second derivatives, as for all velocities but `Free`.
        """
        raise InputError(
            f"`velocity` must provide second derivatives for this loss, got {type(self).__name__}. Try `velocity=free`."
        )


class LearnedVelocity(Velocity):
    """A velocity field computed from the outputs of a network of (x, t).

    The jet of f counts as data: no gradient flows from V into f.

    Args:
        dim: Dimension d of space.
        outputs: Number of outputs that the network must have.
        network: Builds the network; called with ``in_features`` and ``out_features``.
    """

    def __init__(self, dim: int, outputs: int, network: NetworkFactory) -> None:
        super().__init__(dim)
        self.network = network(in_features=dim + 1, out_features=outputs)
