"""Fields and velocities that a reflection leaves unchanged, by construction.

They are averages over a network and its mirror image, so every identity of the networks (a vanishing divergence, closed
derivatives) holds for them, too. Both halves are evaluated together; an evaluation costs twice that of the network.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.fields.scalar import ScalarNetwork
from nsm.fields.velocity import Velocity
from nsm.geometry.reflection import Reflection
from nsm.types import Jet, Key, SignedDistance, VectorJet


class SymmetricField(ScalarNetwork):
    """f_s(x, t) = ½ (f(x, t) + f(x', t)) with x' the mirror image of x, so that f_s(x', t) = f_s(x, t).

    Args:
        network: Network of f.
        normal: Normal of the mirror plane, d numbers.
        offset: Distance of the plane from the origin along the normal.

    Example:
        >>> import torch
        >>> from nsm.fields import ScalarSiren, SymmetricField
        >>> field = SymmetricField(ScalarSiren(in_features=4, hidden_features=16, hidden_layers=2), [1, 0, 0])
        >>> p = torch.rand(5, 4)
        >>> torch.allclose(field(p), field(p * torch.tensor([-1.0, 1.0, 1.0, 1.0])))
        True
    """

    def __init__(self, network: ScalarNetwork, normal: Sequence[float], offset: float = 0.0) -> None:
        super().__init__()
        self.network, self.reflection = network, Reflection.at(normal, offset)
        self.in_features, self.hidden_features = network.in_features, network.hidden_features
        self.hidden_layers = network.hidden_layers

    @property
    def core(self) -> ScalarNetwork:
        return self.network.core

    @property
    def symmetry(self) -> dict[str, Any]:
        return {"normal": list(self.reflection.normal), "offset": self.reflection.offset}

    @property
    def bound(self) -> Float[Tensor, ""]:
        """The bound of the network, which the average keeps for planes perpendicular to an axis."""
        return self.network.bound

    def forward(self, x: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        here, there = self.network(self._both(x)).chunk(2)
        return (here + there) / 2

    def jet(self, x: Float[Tensor, "n k"]) -> Jet:
        values, gradients = (part.chunk(2) for part in self.network.jet(self._both(x)))
        gradient = gradients[0] + self.reflection.vectors(gradients[1])
        return Jet((values[0] + values[1]) / 2, gradient / 2)

    def hessian(self, x: Float[Tensor, "n k"], directions: int) -> Float[Tensor, "n directions k"]:
        here, there = self.network.hessian(self._both(x), directions).chunk(2)
        rows = self.reflection.vectors(there)
        return (here + self.reflection.vectors(rows.mT).mT) / 2

    def _both(self, x: Tensor) -> Tensor:
        return torch.cat([x, self.reflection.points(x)])


class SymmetricVelocity(Velocity):
    """V_s(x, t) = ½ (V(x, t) + R V(x', t)) with x' the mirror image of x, so that V_s(x', t) = R V_s(x, t).

    With a symmetric f, whose jet it is given, div V_s(x) = ½ (div V(x) + div V(x')), so V_s has no divergence where V
    has none. For `AdaDiv`, β(f) is the same at x and x', and V_s is again a curl plus β(f) times a gradient.

    Args:
        velocity: V.
        normal: Normal of the mirror plane, d numbers.
        offset: Distance of the plane from the origin along the normal.
    """

    def __init__(self, velocity: Velocity, normal: Sequence[float], offset: float = 0.0) -> None:
        super().__init__(velocity.dim)
        self.velocity, self.reflection = velocity, Reflection.at(normal, offset)

    @property
    def core(self) -> Velocity:
        return self.velocity.core

    def attach(self, field: ScalarNetwork, keys: Sequence[Key[SignedDistance]]) -> None:
        self.velocity.attach(field, keys)

    def forward(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, "n d"]:
        here, there = self.velocity(*self._both(p, f)).chunk(2)
        return (here + self.reflection.vectors(there)) / 2

    def divergence(self, p: Float[Tensor, "n k"], f: Jet) -> Float[Tensor, " n"]:
        """Evaluate ½ (div V(x) + div V(x')).

        Args:
            p: Points (x, t) in space-time, shape (n, d + 1).
            f: Value and gradient of f at these points.

        Returns:
            Divergences, shape (n,).
        """
        here, there = self.velocity.divergence(*self._both(p, f)).chunk(2)
        return (here + there) / 2

    def jet_and_laplacian(self, p: Float[Tensor, "n k"]) -> tuple[VectorJet, Float[Tensor, "n d"]]:
        mirror = self.reflection
        jet, laplacian = self.velocity.jet_and_laplacian(torch.cat([p, mirror.points(p)]))
        values, jacobians, laplacians = (part.chunk(2) for part in (*jet, laplacian))
        jacobian = mirror.vectors(mirror.vectors(jacobians[1]).mT).mT
        value, curvature = ((here + mirror.vectors(there)) / 2 for here, there in (values, laplacians))
        return VectorJet(value, (jacobians[0] + jacobian) / 2), curvature

    def _both(self, p: Tensor, f: Jet) -> tuple[Tensor, Jet]:
        """Points and their mirror images, (2n, d + 1), with the jet of a symmetric f there."""
        gradient = torch.cat([f.gradient, self.reflection.vectors(f.gradient)])
        return torch.cat([p, self.reflection.points(p)]), Jet(f.value.repeat(2), gradient)
