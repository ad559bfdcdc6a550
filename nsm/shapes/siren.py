"""Shapes that are sine networks."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm.fields.siren import ScalarSiren
from nsm.geometry.distance import Closest, closest_points
from nsm.geometry.grid import CHUNK, evaluate
from nsm.geometry.triangles import Triangles
from nsm.shapes.base import FieldShape, working_box
from nsm.shapes.primitive import Pose
from nsm.shapes.similarity import Similarity
from nsm.types import Jet

log = logging.getLogger(__name__)

#: Points of its domain at which a network is compared with the distance to its surface.
_COMPARED = 5000
#: A network that differs from the distance to its surface by more than this part of half its domain is told of.
_DEVIATION = 0.02
#: ‖∇g‖ is not taken smaller than this when a value is turned into a distance.
_LEAST_SLOPE = 0.3


class SirenShape(FieldShape):
    """A signed distance that is a sine network, placed in the box by a similarity.

    A network holds anything outside the box where it was trained. There, its value at the nearest point of that
    domain plus the distance to it takes its place: continuous, positive, and at least the distance to the surface.
    The weights are frozen: an end shape does not train.

    Args:
        in_features: dimension d.
        hidden_features: width.
        hidden_layers: number of hidden layers.
        omega: ω, one number or one a layer.
        pose: from the coordinates of the file to the box.
        origin: where the network comes from (part of the provenance).
        placement: from the network's own coordinates, those of its input, to the box.
        domain: corners [lowest, highest] of the box in own coordinates where the network was trained; None if it is not
            known, and the network is read everywhere.
    """

    def __init__(
        self,
        in_features: int,
        hidden_features: int,
        hidden_layers: int,
        omega: float | Sequence[float],
        pose: Pose = None,
        origin: Mapping[str, Any] | None = None,
        placement: Pose = None,
        domain: Sequence[Sequence[float]] | None = None,
    ) -> None:
        super().__init__(in_features, Similarity.read(pose, in_features), Similarity.read(placement, in_features))
        omegas = float(omega) if isinstance(omega, (int, float)) else [float(w) for w in omega]
        self.network = ScalarSiren(in_features, hidden_features, hidden_layers, omegas).requires_grad_(False)
        self.origin = dict(origin or {"kind": "network"})
        self.domain = None if domain is None else torch.tensor([list(corner) for corner in domain], dtype=torch.float64)
        self._triangles: Triangles | None = None

    @classmethod
    def from_network(
        cls,
        network: ScalarSiren,
        pose: Pose = None,
        origin: Mapping[str, Any] | None = None,
        domain: Sequence[Sequence[float]] | None = None,
    ) -> SirenShape:
        """A frozen copy of a network whose own coordinates are those of the box.

        Args:
            network: g.
            pose: from the coordinates of the file to the box.
            origin: where the network comes from.
            domain: corners of the box where it was trained.
        """
        size = network.in_features, network.hidden_features, network.hidden_layers
        shape = SirenShape(*size, network.omegas, pose, origin, domain=domain)
        shape.network.to(network.linear_layers[0].weight)
        shape.network.load_state_dict(network.state_dict())
        return shape

    def own_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """The network in its domain, and its continuation outside."""
        nearest = self._nearest(p)
        return self.network(nearest) + (p - nearest).norm(dim=1)

    def own_jet(self, p: Float[Tensor, "n d"]) -> Jet:
        """Value and gradient in closed form."""
        nearest = self._nearest(p)
        away, inner = p - nearest, self.network.jet(nearest)
        along = inner.gradient * (away == 0)
        return Jet(inner.value + away.norm(dim=1), along + nn.functional.normalize(away, dim=1))

    def folded(self) -> ScalarSiren:
        """The network in the coordinates of the box: the placement is folded into its weights."""
        network = SirenShape.from_network(self.network).network
        fold_similarity_(network, self.placement)
        return network

    def covers(self, half_width: float) -> bool:
        """Whether the network was trained in all of the box [−h, h]^d."""
        if self.domain is None:
            return False
        corners = torch.cartesian_prod(*[torch.tensor([-half_width, half_width], dtype=torch.float64)] * self.dim)
        own, slack = self.placement.pull_back(corners), 1e-6 * float((self.domain[1] - self.domain[0]).max())
        return bool(((own >= self.domain[0] - slack) & (own <= self.domain[1] + slack)).all())

    def true_distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Distance to the extracted surface, signed by the network in its domain and positive outside.

        Closer to the surface than half a cell of its extraction, it is |g|/‖∇g‖ of the network.
        """
        return self.placement.scale * self._own_true_distance(self.placement.pull_back(x))

    def config(self) -> dict[str, Any]:
        """Architecture, placement, domain and origin; the weights are the state."""
        network = self.network
        return {
            "_target_": "nsm.shapes.SirenShape",
            "in_features": network.in_features,
            "hidden_features": network.hidden_features,
            "hidden_layers": network.hidden_layers,
            "omega": list(network.omegas),
            "pose": self.similarity.to_config(),
            "origin": self.origin,
            "placement": self.placement.to_config(),
            "domain": None if self.domain is None else self.domain.tolist(),
        }

    def own_box(self) -> Float[Tensor, "2 d"]:
        """The domain; [-1, 1]^d where none is known."""
        return working_box(self.dim) if self.domain is None else self.domain.to(torch.get_default_dtype())

    def provenance(self) -> dict[str, Any]:
        """The origin, and the similarity from the coordinates of the file to the box."""
        return {**self.origin, "similarity": self.similarity.to_config()}

    @torch.no_grad()
    def tell_deviation(self) -> None:
        """Say in the log how far the network is from the distance to its surface, where that is far."""
        low, high = self.own_box()
        generator = torch.Generator().manual_seed(0)
        p = low + (high - low) * torch.rand(_COMPARED, self.dim, generator=generator)
        jet = self.own_jet(p)
        slope, off = jet.gradient.norm(dim=1), (jet.value - self._own_true_distance(p)).abs()
        if float(off.max()) > _DEVIATION * float((high - low).max()) / 2:
            log.info(
                "%s deviates from a distance (‖∇g‖ = %.2f ± %.2f in its domain, |g| wrong by up to %.2g): distances to "
                "its surface are used",
                *(self.origin.get("path", "the network"), slope.mean(), slope.std(), off.max()),
            )

    def _resolution(self, standard: dict[int, int]) -> int:
        """As many cells per unit of length as [-1, 1]^d has in the standard resolution."""
        low, high = self.own_box()
        return max(1, round(standard[self.dim] * float((high - low).max()) / 2))

    def _nearest(self, p: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """The nearest points of the domain."""
        return p if self.domain is None else p.clamp(*self.domain.to(p))

    @torch.no_grad()
    def _own_true_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        distance, half_cell = self._closest(p).distances, self._own_cell() / 2
        # outside the domain the continuation is positive, so it has the right sign too
        signed = distance.copysign(evaluate(self.own_distance, p))
        near = distance < half_cell
        jets = [self.own_jet(chunk) for chunk in p[near].split(CHUNK)]
        value = torch.cat([jet.value for jet in jets])
        slope = torch.cat([jet.gradient for jet in jets]).norm(dim=1).clamp(min=_LEAST_SLOPE)
        known = (value.abs() / slope).minimum(distance[near] + half_cell)
        signed[near] = known.copysign(value)
        return signed

    def _closest(self, p: Float[Tensor, "n d"]) -> Closest:
        if self.dim == 2:
            return closest_points(p, self.own_surface())
        if self._triangles is None:
            vertices, faces = self.own_surface()
            self._triangles = Triangles(vertices.double().cpu().numpy(), faces.cpu().numpy())
        return self._triangles.closest(p)


@torch.no_grad()
def fold_similarity_(network: ScalarSiren, similarity: Similarity) -> None:
    """Turn the network g into x ↦ s g(Rᵀ(x − t)/s), by its first and last layer (section 7 of the paper).

    The weights become W_1 Rᵀ/s, b_1 − W_1 Rᵀ t/s, s W_{L+1} and s b_{L+1}.
    """
    first, last = network.linear_layers[0], network.linear_layers[-1]
    device = first.weight.device
    pulled = first.weight.double() @ similarity.rotation.to(device).T / similarity.scale
    first.bias.copy_(first.bias.double() - pulled @ similarity.translation.to(device))
    first.weight.copy_(pulled)
    last.weight.mul_(similarity.scale)
    last.bias.mul_(similarity.scale)
