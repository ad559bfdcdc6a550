"""A velocity without divergence."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from nsm import calculus
from nsm.fields.velocity.base import LearnedVelocity, NetworkFactory
from nsm.types import Jet


class NullDiv(LearnedVelocity):
    """A divergence-free velocity, V = curl D in 3D and the skew gradient of H in 2D.

    In general V_i = Σ_j ∂_j A_ij for a learned antisymmetric matrix A (paper, section 4 and appendix A). Because the
    divergence vanishes everywhere, V preserves the volume of *every* level set of f, which contradicts ‖∇f‖ = 1.

    Args:
        dim: Dimension d of space.
        network: Builds the network of the d(d − 1)/2 potentials; called with ``in_features`` and ``out_features``.

    References:
        Richter-Powell, Lipman, and Chen, Neural Conservation Laws: A Divergence-Free Perspective, NeurIPS 2022.
        https://arxiv.org/abs/2210.01741

    Example:
        >>> from functools import partial
        >>> import torch
        >>> from nsm.fields import NullDiv, ScalarSiren, VectorSiren
        >>> velocity = NullDiv(dim=2, network=partial(VectorSiren, hidden_features=16, hidden_layers=2))
        >>> p = torch.rand(5, 3)
        >>> velocity.divergence(p, ScalarSiren(3, 16, 2).jet(p))
        tensor([0., 0., 0., 0., 0.])
    """

    def __init__(self, dim: int, network: NetworkFactory) -> None:
        super().__init__(dim, calculus.potential_count(dim), network)

    def forward(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, "n d"]:
        return calculus.antisymmetric_divergence(self.network.jet(p, self.dim).jacobian)

    def divergence(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, " n"]:
        return p.new_zeros(len(p))
