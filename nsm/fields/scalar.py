"""The interface of networks that represent f(x, t)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from jaxtyping import Float
from torch import Tensor, nn

from nsm.cli.errors import InputError
from nsm.types import Jet


class ScalarNetwork(nn.Module, ABC):
    """A scalar field represented by a network, with its gradient in closed form.

    Attributes:
        in_features: Number of inputs k: the coordinates of space, followed by time where there is one.
        hidden_features: Width of the hidden layers.
        hidden_layers: Number of hidden layers.
    """

    in_features: int
    hidden_features: int
    hidden_layers: int

    @abstractmethod
    def forward(self, x: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        """Evaluate the field at points of shape (n, k)."""

    @abstractmethod
    def jet(self, x: Float[Tensor, "n k"]) -> Jet:
        """Evaluate the field and its gradient at points of shape (n, k)."""

    @property
    def core(self) -> ScalarNetwork:
        """The network whose weights are initialized: this one, or the one that a composition is made of."""
        return self

    @property
    def symmetry(self) -> dict[str, Any] | None:
        """Mirror plane of a symmetric field as plain values, ``normal`` and ``offset``; None for any other field."""
        return None

    @property
    def bound(self) -> Float[Tensor, ""]:
        """Bound on the Lipschitz constant of the field.

        Raises:
            InputError: If the network knows none, as for all networks but `LipschitzMlp`.
        """
        raise InputError(
            f"`field` must be a Lipschitz network for this loss, got {type(self).__name__}. Try `field=lipschitz`."
        )

    def hessian(self, x: Float[Tensor, "n k"], directions: int) -> Float[Tensor, "n directions k"]:
        """Evaluate second derivatives, one of the two along the first ``directions`` inputs.

        Raises:
            InputError: If the network has no closed-form Hessian, as for all networks but `ScalarSiren`.
        """
        raise InputError(
            f"`field` must provide second derivatives for this velocity, got {type(self).__name__}. Try `field=siren`."
        )
