"""An unconstrained velocity."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from nsm import calculus
from nsm.fields.velocity.base import LearnedVelocity, NetworkFactory
from nsm.types import Jet, VectorJet


class Free(LearnedVelocity):
    """The output of a network, without any constraint: V = V_θ(x, t).

    Args:
        dim: Dimension d of space.
        network: Builds the network; called with ``in_features`` and ``out_features``.

    Example:
        >>> from functools import partial
        >>> import torch
        >>> from nsm.fields import Free, ScalarSiren, VectorSiren
        >>> velocity = Free(dim=3, network=partial(VectorSiren, hidden_features=16, hidden_layers=2))
        >>> p = torch.rand(5, 4)
        >>> velocity(p, ScalarSiren(4, 16, 2).jet(p)).shape
        torch.Size([5, 3])
    """

    def __init__(self, dim: int, network: NetworkFactory) -> None:
        super().__init__(dim, dim, network)

    def forward(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, "n d"]:
        return self.network(p)

    def divergence(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, " n"]:
        return calculus.divergence(self.network.jet(p, self.dim).jacobian)

    def jet_and_laplacian(self, p: Float[Tensor, "n k"]) -> tuple[VectorJet, Float[Tensor, "n d"]]:
        return self.network.jet_and_laplacian(p, self.dim)
