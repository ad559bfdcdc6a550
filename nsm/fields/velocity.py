"""Velocity fields V(x, t) that carry the level sets of f.

Each takes points of space-time, p = (x, t) of shape (n, d + 1), and the `Jet` of f there, and returns V (n, d).
The jet is taken as data: no gradient flows from V into f through β.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm import calculus
from nsm.fields.beta import Beta
from nsm.fields.siren import VectorSiren
from nsm.types import Jet

#: Makes a network when called with ``in_features`` and ``out_features``: what a configured, still open network is.
NetworkFactory = Callable[..., VectorSiren]


class Velocity(nn.Module, ABC):
    """A velocity field in ``dim`` dimensions.

    Args:
        dim: dimension d of space.
        outputs: how many outputs the network must have.
        network: makes the network, called with ``in_features`` and ``out_features``.
    """

    def __init__(self, dim: int, outputs: int, network: NetworkFactory) -> None:
        super().__init__()
        self.dim = dim
        self.network = network(in_features=dim + 1, out_features=outputs)

    @abstractmethod
    def forward(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, "n d"]:
        """Velocity V (n, d) at p = (x, t), where f has the jet given."""

    @abstractmethod
    def divergence(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, " n"]:
        """Divergence of V in space (n,), in closed form."""


class Free(Velocity):
    """V is the network itself, with no constraint."""

    def __init__(self, dim: int, network: NetworkFactory) -> None:
        super().__init__(dim, dim, network)

    def forward(self, p: Tensor, f: Jet) -> Tensor:
        return self.network(p)

    def divergence(self, p: Tensor, f: Jet) -> Tensor:
        return calculus.divergence(self.network.jet(p, self.dim).jacobian)


class NullDiv(Velocity):
    """V_i = Σ_j ∂_j A_ij for a learned antisymmetric A: curl D in 3D, the skew gradient in 2D (paper, section 4).

    Its divergence is zero everywhere, so the volume of *every* level set is kept.
    """

    def __init__(self, dim: int, network: NetworkFactory) -> None:
        super().__init__(dim, calculus.potentials(dim), network)

    def forward(self, p: Tensor, f: Jet) -> Tensor:
        return calculus.antisymmetric_divergence(self.network.jet(p, self.dim).jacobian)

    def divergence(self, p: Tensor, f: Jet) -> Tensor:
        return p.new_zeros(len(p))


class AdaDiv(Velocity):
    """V = curl D + β(f) ∇u (paper, eq. 5), with D and u the outputs of one network: u first, then D.

    Where f = 0 both β and β' vanish, so V = curl D and div V = 0 there, and the volume of the moving shape is kept
    (theorem 1), while f may stay a distance elsewhere.
    """

    def __init__(self, dim: int, network: NetworkFactory, beta: Beta) -> None:
        super().__init__(dim, 1 + calculus.potentials(dim), network)
        self.beta = beta

    def forward(self, p: Tensor, f: Jet) -> Tensor:
        jacobian = self.network.jet(p, self.dim).jacobian
        solenoidal = calculus.antisymmetric_divergence(jacobian[:, 1:])
        return torch.addcmul(solenoidal, self.beta(f.value.detach())[:, None], jacobian[:, 0])

    def divergence(self, p: Tensor, f: Jet) -> Tensor:
        """β(f) Δu + β'(f) ⟨∇f, ∇u⟩ (paper, eq. 6)."""
        jet, laplacian = calculus.value_jacobian_and_laplacian(self.network.layers, p, self.dim)
        distance, normal = f.value.detach(), f.gradient[:, : self.dim].detach()
        along = (normal * jet.jacobian[:, 0]).sum(1)
        return self.beta(distance) * laplacian[:, 0] + self.beta.derivative(distance) * along
