"""Shapes represented by sine networks."""

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
from nsm.shapes.similarity import Pose, Similarity
from nsm.types import Jet

log = logging.getLogger(__name__)

#: Number of points at which a network is compared with the distance to its surface.
_COMPARED = 5000
#: Deviation from the distance above which a network is reported, relative to half its domain.
_MAX_DEVIATION = 0.02
#: Lower bound on ‖∇g‖ when a value is converted to a distance.
_MIN_SLOPE = 0.3


class SirenShape(FieldShape):
    """A signed distance represented by a sine network and placed in the box by a similarity.

    The values of a network are arbitrary outside the domain where it was trained. There they are replaced by the value
    at the nearest point of the domain plus the distance to it, which is continuous, positive, and at least the distance
    to the surface. The weights are frozen, because an end shape is not trained.

    Args:
        in_features: Dimension d of space.
        hidden_features: Width of the hidden layers.
        hidden_layers: Number of hidden layers.
        omega: Frequency ω, one number or one for each layer.
        pose: Map from the coordinates of the file to the box.
        origin: Origin of the network, for the provenance.
        placement: Map from local coordinates, the input of the network, to the box.
        domain: Corners [lowest, highest] of the box in local coordinates where the network was trained; None if it is
            unknown, and the network is evaluated everywhere.

    Example:
        >>> import torch
        >>> from nsm.fields import ScalarSiren
        >>> from nsm.shapes import SirenShape
        >>> network = ScalarSiren(in_features=3, hidden_features=16, hidden_layers=2)
        >>> shape = SirenShape.from_network(network, pose={"scale": 2.0})
        >>> x = torch.rand(5, 3)
        >>> torch.equal(shape(x), network(x))  # the pose describes the file: the placement is the identity
        True
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
        """Create a shape with a frozen copy of a network whose input is in the coordinates of the box.

        Args:
            network: The network g.
            pose: Map from the coordinates of the file to the box.
            origin: Origin of the network, for the provenance.
            domain: Corners of the box where the network was trained.
        """
        size = network.in_features, network.hidden_features, network.hidden_layers
        shape = SirenShape(*size, network.omegas, pose, origin, domain=domain)
        shape.network.to(network.linear_layers[0].weight)
        shape.network.load_state_dict(network.state_dict())
        return shape

    def local_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Evaluate the network in its domain, and its continuation outside."""
        nearest = self._nearest(p)
        return self.network(nearest) + (p - nearest).norm(dim=1)

    def local_jet(self, p: Float[Tensor, "n d"]) -> Jet:
        """Evaluate value and gradient in closed form."""
        nearest = self._nearest(p)
        offset, inner = p - nearest, self.network.jet(nearest)
        tangential = inner.gradient * (offset == 0)
        return Jet(inner.value + offset.norm(dim=1), tangential + nn.functional.normalize(offset, dim=1))

    def folded(self) -> ScalarSiren:
        """Return a network in the coordinates of the box, with the placement folded into its weights."""
        network = SirenShape.from_network(self.network).network
        fold_similarity_(network, self.placement)
        return network

    def covers(self, half_width: float) -> bool:
        """Check whether the domain of the network contains the box [−h, h]^d."""
        if self.domain is None:
            return False
        corners = torch.cartesian_prod(*[torch.tensor([-half_width, half_width], dtype=torch.float64)] * self.dim)
        local, slack = self.placement.pull_back(corners), 1e-6 * float((self.domain[1] - self.domain[0]).max())
        return bool(((local >= self.domain[0] - slack) & (local <= self.domain[1] + slack)).all())

    def true_distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Evaluate the distance to the extracted surface, signed by the network in its domain and positive outside.

        Within half a cell of the surface, the distance is |g|/‖∇g‖ of the network.
        """
        return self.placement.scale * self._local_true_distance(self.placement.pull_back(x))

    def config(self) -> dict[str, Any]:
        """Return architecture, placement, domain, and origin; the weights are the state."""
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

    def local_box(self) -> Float[Tensor, "2 d"]:
        """Return the domain, or [-1, 1]^d if it is unknown."""
        return working_box(self.dim) if self.domain is None else self.domain.to(torch.get_default_dtype())

    def provenance(self) -> dict[str, Any]:
        """Return the origin, and the similarity from the coordinates of the file to the box."""
        return {**self.origin, "similarity": self.similarity.to_config()}

    @torch.no_grad()
    def log_deviation(self) -> None:
        """Log the deviation of the network from the distance to its surface if it is large."""
        low, high = self.local_box()
        generator = torch.Generator().manual_seed(0)
        p = low + (high - low) * torch.rand(_COMPARED, self.dim, generator=generator)
        jet = self.local_jet(p)
        slope, deviation = jet.gradient.norm(dim=1), (jet.value - self._local_true_distance(p)).abs()
        if float(deviation.max()) > _MAX_DEVIATION * float((high - low).max()) / 2:
            log.info(
                "%s deviates from a distance (‖∇g‖ = %.2f ± %.2f in its domain, maximum error of |g| %.2g), so "
                "distances to its surface are used",
                *(self.origin.get("path", "the network"), slope.mean(), slope.std(), deviation.max()),
            )

    def _resolution(self, standard: dict[int, int]) -> int:
        """Return the number of cells that keeps the cell size of the standard resolution on [-1, 1]^d."""
        low, high = self.local_box()
        return max(1, round(standard[self.dim] * float((high - low).max()) / 2))

    def _nearest(self, p: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Clamp points to the domain."""
        return p if self.domain is None else p.clamp(*self.domain.to(p))

    @torch.no_grad()
    def _local_true_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        distance, half_cell = self._closest(p).distances, self._local_cell() / 2
        # the continuation outside the domain is positive, so its sign is correct as well
        signed = distance.copysign(evaluate(self.local_distance, p))
        near = distance < half_cell
        jets = [self.local_jet(chunk) for chunk in p[near].split(CHUNK)]
        value = torch.cat([jet.value for jet in jets])
        slope = torch.cat([jet.gradient for jet in jets]).norm(dim=1).clamp(min=_MIN_SLOPE)
        known = (value.abs() / slope).minimum(distance[near] + half_cell)
        signed[near] = known.copysign(value)
        return signed

    def _closest(self, p: Float[Tensor, "n d"]) -> Closest:
        if self.dim == 2:
            return closest_points(p, self.local_surface())
        if self._triangles is None:
            vertices, faces = self.local_surface()
            self._triangles = Triangles(vertices.double().cpu().numpy(), faces.cpu().numpy())
        return self._triangles.closest(p)


@torch.no_grad()
def fold_similarity_(network: ScalarSiren, similarity: Similarity) -> None:
    """Replace the network g by x ↦ s g(Rᵀ(x − t)/s) through its first and last layer (paper, section 7).

    The parameters become W_1 Rᵀ/s, b_1 − W_1 Rᵀ t/s, s W_{L+1}, and s b_{L+1}.

    Args:
        network: The network, modified in place.
        similarity: The similarity with rotation R, translation t, and scale s.
    """
    first, last = network.linear_layers[0], network.linear_layers[-1]
    device = first.weight.device
    pulled = first.weight.double() @ similarity.rotation.to(device).T / similarity.scale
    first.bias.copy_(first.bias.double() - pulled @ similarity.translation.to(device))
    first.weight.copy_(pulled)
    last.weight.mul_(similarity.scale)
    last.bias.mul_(similarity.scale)
