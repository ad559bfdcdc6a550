"""A velocity with adaptive divergence."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from nsm import calculus
from nsm.fields.beta import Beta
from nsm.fields.velocity.base import LearnedVelocity, NetworkFactory
from nsm.types import Jet


class AdaDiv(LearnedVelocity):
    """A velocity whose divergence vanishes on the moving surface, V = curl D + β(f) ∇u (paper, eq. 5).

    One network outputs u, then D. On {f = 0} both β and β' vanish, so V = curl D and div V = 0 there: V preserves the
    volume of the moving shape (theorem 1), while f can remain a signed distance elsewhere.

    Args:
        dim: Dimension d of space.
        network: Builds the network; called with ``in_features`` and ``out_features``.
        beta: The function β.

    References:
        Buonomo, Digne, and Chaine, Volume Preserving Neural Shape Morphing, Computer Graphics Forum (SGP) 2025.
        https://github.com/camillebnm/neural_shape_morphing

    Example:
        >>> from functools import partial
        >>> import torch
        >>> from nsm.fields import AdaDiv, Gaussian, VectorSiren
        >>> from nsm.types import Jet
        >>> network = partial(VectorSiren, hidden_features=16, hidden_layers=2)
        >>> velocity = AdaDiv(dim=3, network=network, beta=Gaussian(alpha=0.1))
        >>> p = torch.rand(4, 4)
        >>> on_surface = Jet(value=torch.zeros(4), gradient=torch.rand(4, 4))
        >>> velocity.divergence(p, on_surface).detach()
        tensor([0., 0., 0., 0.])
    """

    def __init__(self, dim: int, network: NetworkFactory, beta: Beta) -> None:
        super().__init__(dim, 1 + calculus.potential_count(dim), network)
        self.beta = beta

    def forward(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, "n d"]:
        jacobian = self.network.jet(p, self.dim).jacobian
        solenoidal = calculus.antisymmetric_divergence(jacobian[:, 1:])
        return torch.addcmul(solenoidal, self.beta(f.value.detach())[:, None], jacobian[:, 0])

    def divergence(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, " n"]:
        """Evaluate div V = β(f) Δu + β'(f) ⟨∇f, ∇u⟩ (paper, eq. 6)."""
        jet, laplacian = calculus.value_jacobian_and_laplacian(self.network.layers, p, self.dim)
        distance, gradient = f.value.detach(), f.gradient[:, : self.dim].detach()
        alignment = (gradient * jet.jacobian[:, 0]).sum(1)
        return self.beta(distance) * laplacian[:, 0] + self.beta.derivative(distance) * alignment
