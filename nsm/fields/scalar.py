"""What f(x, t) may be: a network with one output that knows its gradient."""

from __future__ import annotations

from abc import ABC, abstractmethod

from jaxtyping import Float
from torch import Tensor, nn

from nsm.types import Jet


class ScalarNetwork(nn.Module, ABC):
    """A scalar field made of a network.

    Attributes:
        in_features: number of inputs k (space, or space and time last).
        hidden_features: width of the hidden layers.
        hidden_layers: how many there are.
    """

    in_features: int
    hidden_features: int
    hidden_layers: int

    @abstractmethod
    def forward(self, x: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        """Value (n,) at x (n, k)."""

    @abstractmethod
    def jet(self, x: Float[Tensor, "n k"]) -> Jet:
        """Value (n,) and gradient (n, k) at x (n, k)."""
