"""Velocity fields V(x, t) that carry the level sets of f.

Each takes points of space-time, p = (x, t) of shape (n, d + 1), and the `Jet` of f there, and returns V (n, d).
Where V is learned, the jet is taken as data: no gradient flows from V into f.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm import calculus
from nsm.fields.beta import Beta
from nsm.fields.scalar import ScalarNetwork
from nsm.fields.siren import ScalarSiren, VectorSiren
from nsm.types import Jet, SignedDistance, VectorJet

#: Makes a network when called with ``in_features`` and ``out_features``: what a configured, still open network is.
NetworkFactory = Callable[..., VectorSiren]


class Velocity(nn.Module, ABC):
    """A velocity field in ``dim`` dimensions.

    Args:
        dim: dimension d of space.
    """

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.dim = dim

    def attach(self, field: ScalarNetwork, target: SignedDistance) -> None:
        """Tell the network f and the shape at t = 1, once, to fields that are made of them; they stay the morph's."""

    @abstractmethod
    def forward(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, "n d"]:
        """Velocity V (n, d) at p = (x, t), where f has the jet given."""

    @abstractmethod
    def divergence(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, " n"]:
        """Divergence of V in space (n,), in closed form."""


class LearnedVelocity(Velocity):
    """A velocity field made from the outputs of a network of (x, t).

    Args:
        dim: dimension d of space.
        outputs: how many outputs the network must have.
        network: makes the network, called with ``in_features`` and ``out_features``.
    """

    def __init__(self, dim: int, outputs: int, network: NetworkFactory) -> None:
        super().__init__(dim)
        self.network = network(in_features=dim + 1, out_features=outputs)


class Free(LearnedVelocity):
    """V is the network itself, with no constraint."""

    def __init__(self, dim: int, network: NetworkFactory) -> None:
        super().__init__(dim, dim, network)

    def forward(self, p: Tensor, f: Jet) -> Tensor:
        return self.network(p)

    def divergence(self, p: Tensor, f: Jet) -> Tensor:
        return calculus.divergence(self.network.jet(p, self.dim).jacobian)

    def jet_and_laplacian(self, p: Float[Tensor, "n k"]) -> tuple[VectorJet, Float[Tensor, "n d"]]:
        """V, its Jacobian in space and its vector Laplacian ΔV (n, d) at p, in one propagation."""
        return self.network.jet_and_laplacian(p, self.dim)


class NullDiv(LearnedVelocity):
    """V_i = Σ_j ∂_j A_ij for a learned antisymmetric A: curl D in 3D, the skew gradient in 2D (paper, section 4).

    Its divergence is zero everywhere, so the volume of *every* level set is kept.
    """

    def __init__(self, dim: int, network: NetworkFactory) -> None:
        super().__init__(dim, calculus.potentials(dim), network)

    def forward(self, p: Tensor, f: Jet) -> Tensor:
        return calculus.antisymmetric_divergence(self.network.jet(p, self.dim).jacobian)

    def divergence(self, p: Tensor, f: Jet) -> Tensor:
        return p.new_zeros(len(p))


class AdaDiv(LearnedVelocity):
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


class Nise(Velocity):
    """V = −s e^{−γ f²} (g₁ − f) ∇f/‖∇f‖: the surface moves along its normals until f is the target's g₁ (eq. 3).

    Nothing is learned: V is made of f and of the target, and so the gradient of V in f is followed. With s = 1 and
    γ = 0 it is the field of the paper (Novello et al., Neural Implicit Surface Evolution, ICCV 2023); the authors of
    the volume-preserving method compare with s = ½ and γ = 1.

    Args:
        dim: dimension d of space.
        scale: s.
        decay: γ, in 1/length².
    """

    def __init__(self, dim: int, scale: float = 1.0, decay: float = 0.0) -> None:
        super().__init__(dim)
        self.scale, self.decay = float(scale), float(decay)
        self._owned: tuple[ScalarNetwork, SignedDistance] | None = None

    def attach(self, field: ScalarNetwork, target: SignedDistance) -> None:
        self._owned = (field, target)

    def forward(self, p: Tensor, f: Jet) -> Tensor:
        gradient = f.gradient[:, : self.dim]
        return -self._speed(p, f.value)[:, None] * gradient / _length(gradient)

    def divergence(self, p: Tensor, f: Jet) -> Tensor:
        """−⟨∇s, n⟩ − s (Δf − ⟨n, H n⟩)/‖∇f‖, with s the speed, n = ∇f/‖∇f‖ and H the Hessian of f."""
        field, target = self._attached()
        if not isinstance(field, ScalarSiren):
            raise TypeError(f"the Hessian of {type(field).__name__} is not known: give f a ScalarSiren")
        gradient, remaining = f.gradient[:, : self.dim], self._remaining(p, f.value)
        length = _length(gradient)
        normal = gradient / length
        hessian = field.hessian(p, self.dim)[:, :, : self.dim]
        curvature = hessian.diagonal(dim1=1, dim2=2).sum(1) - torch.einsum("ni,nij,nj->n", normal, hessian, normal)
        along = (_gradient(target, p[:, : self.dim]) * normal).sum(1) - length[:, 0]
        weight = self.scale * torch.exp(-self.decay * f.value.square())
        rise = weight * (along - 2 * self.decay * f.value * remaining * length[:, 0])
        return -rise - weight * remaining * curvature / length[:, 0]

    def _speed(self, p: Tensor, value: Tensor) -> Tensor:
        """s e^{−γ f²} (g₁ − f), against the normal (n,)."""
        return self.scale * torch.exp(-self.decay * value.square()) * self._remaining(p, value)

    def _remaining(self, p: Tensor, value: Tensor) -> Tensor:
        return self._attached()[1](p[:, : self.dim]) - value

    def _attached(self) -> tuple[ScalarNetwork, SignedDistance]:
        if self._owned is None:
            raise ValueError("this velocity is made of f and the target, and knows neither: attach them first")
        return self._owned


def _length(gradient: Tensor) -> Tensor:
    """‖∇f‖ (n, 1), never zero."""
    return gradient.norm(dim=1, keepdim=True).clamp(min=torch.finfo(gradient.dtype).eps)


def _gradient(field: SignedDistance, x: Tensor) -> Tensor:
    with torch.enable_grad():
        x = x.detach().requires_grad_()
        return torch.autograd.grad(field(x).sum(), x)[0]
