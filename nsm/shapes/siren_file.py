"""Shapes that are sine networks, among them the published ones."""

from __future__ import annotations

import pickle
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm.errors import InputError
from nsm.fields.siren import ScalarSiren, Siren
from nsm.geometry.projection import newton_to_level
from nsm.shapes.base import FieldShape, working_box
from nsm.shapes.download import file_sha256, resolve
from nsm.shapes.primitive import Pose
from nsm.shapes.similarity import Similarity
from nsm.types import Jet

#: ω of every layer of the published signed distance networks (camillebnm/neural_shape_morphing).
OFFICIAL_OMEGA = 60.0
#: Largest mean of | |∇g| − 1 | on the surface of a network that passes for a signed distance. The published ones
#: have at most 0.09, and at least 0.16 when read at an ω that is 8 % off.
EIKONAL_TOLERANCE = 0.15
#: Points along a side of the grid on which a loaded network is looked at.
_PROBE_RESOLUTION = {2: 256, 3: 48}
#: At least this many of the points near the surface are looked at, where there are so many.
_PROBE_POINTS = 10000


class SirenShape(FieldShape):
    """A signed distance that is a sine network, posed and scaled by its weights alone.

    With g = W_{L+1} sin(… sin(ω(W_1 x + b_1)) …) + b_{L+1}, the field s g(Rᵀ(x − t)/s) is the network with
    W_1 Rᵀ/s, b_1 − W_1 Rᵀ t/s, s W_{L+1} and s b_{L+1} (section 7 of the paper), so a pose costs nothing.
    The weights are frozen: an end shape does not train.

    Args:
        in_features: dimension d.
        hidden_features: width.
        hidden_layers: number of hidden layers.
        omega: ω, one number or one a layer.
        pose: the similarity that the weights already contain.
        origin: where the network comes from (part of the provenance).
    """

    def __init__(
        self,
        in_features: int,
        hidden_features: int,
        hidden_layers: int,
        omega: float | Sequence[float],
        pose: Pose = None,
        origin: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(in_features, Similarity.read(pose, in_features))
        omegas = float(omega) if isinstance(omega, (int, float)) else [float(w) for w in omega]
        self.network = ScalarSiren(in_features, hidden_features, hidden_layers, omegas).requires_grad_(False)
        self.origin = dict(origin or {"kind": "network"})

    @classmethod
    def from_network(
        cls, network: ScalarSiren, pose: Pose = None, origin: Mapping[str, Any] | None = None
    ) -> SirenShape:
        """A frozen copy of a network; ``pose`` says which similarity it contains."""
        shape = SirenShape(
            network.in_features, network.hidden_features, network.hidden_layers, network.omegas, pose, origin
        )
        shape.network.to(_linears(network)[0].weight)
        shape.network.load_state_dict(network.state_dict())
        return shape

    def forward(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """The network."""
        return self.network(x)

    def jet(self, x: Float[Tensor, "n d"]) -> Jet:
        """Value and gradient in closed form."""
        return self.network.jet(x)

    def transformed(self, similarity: Similarity) -> SirenShape:
        """The same shape moved, by other weights in its first and last layer."""
        moved = SirenShape.from_network(self.network, similarity.after(self.similarity), self.origin)
        fold_similarity_(moved.network, similarity)
        return moved

    def config(self) -> dict[str, Any]:
        """Architecture, pose and origin; the weights are the state."""
        network = self.network
        return {
            "_target_": "nsm.shapes.SirenShape",
            "in_features": network.in_features,
            "hidden_features": network.hidden_features,
            "hidden_layers": network.hidden_layers,
            "omega": list(network.omegas),
            "pose": self.similarity.to_config(),
            "origin": self.origin,
        }

    def own_box(self) -> Float[Tensor, "2 d"]:
        """[-1, 1]^d, where a network was trained; elsewhere it may hold anything."""
        return working_box(self.dim)

    def provenance(self) -> dict[str, Any]:
        """The origin, and the similarity from the network's own coordinates to the box."""
        return {**self.origin, "similarity": self.similarity.to_config()}


class SirenFile(SirenShape):
    """A published network: a state dict ``net.0.0.weight``, ``net.0.0.bias``, … without architecture or ω.

    Args:
        path: a file, or a public name such as ``official/ni/kitten.pth``.
        omega: ω of every hidden layer, which the file does not say (60 for all the published ones).
        pose: rotation, translation and scale given to the shape.

    Raises:
        InputError: if the file holds no such network, or what it holds is no signed distance in [-1, 1]^d.
    """

    def __init__(self, path: str, omega: float = OFFICIAL_OMEGA, pose: Pose = None) -> None:
        file = resolve(path)
        weights = read_layers(file)
        dim, width, hidden = weights[0].shape[1], weights[0].shape[0], len(weights) // 2 - 1
        origin = {"kind": "network", "path": str(path), "sha256": file_sha256(file), "omega": float(omega)}
        similarity = Similarity.read(pose, dim)
        super().__init__(dim, width, hidden, omega, similarity, origin)
        set_layers_(self.network, weights)
        surface = _probe(self.network, str(path), float(omega))
        fold_similarity_(self.network, similarity)
        moved = similarity.apply(surface)
        self.require_in_box(torch.stack([moved.amin(0), moved.amax(0)]))


@torch.no_grad()
def fold_similarity_(network: ScalarSiren, similarity: Similarity) -> None:
    """Turn the network g into x ↦ s g(Rᵀ(x − t)/s), by its first and last layer."""
    first, last = _linears(network)[0], _linears(network)[-1]
    device = first.weight.device
    pulled = first.weight.double() @ similarity.rotation.to(device).T / similarity.scale
    first.bias.copy_(first.bias.double() - pulled @ similarity.translation.to(device))
    first.weight.copy_(pulled)
    last.weight.mul_(similarity.scale)
    last.bias.mul_(similarity.scale)


@torch.no_grad()
def set_layers_(network: Siren, layers: Sequence[Tensor]) -> None:
    """Give a network the weights and biases, in order, that `read_layers` read."""
    for linear, weight, bias in zip(_linears(network), layers[::2], layers[1::2], strict=True):
        linear.weight.copy_(weight)
        linear.bias.copy_(bias)


def _linears(network: Siren) -> list[nn.Linear]:
    return [linear for linear in network.linears if isinstance(linear, nn.Linear)]


def read_layers(file: Path, inputs: Collection[int] = (2, 3), outputs: int = 1) -> list[Tensor]:
    """Weights and biases in order, float32, from a state dict whose keys are ``net.<layer>.0.weight`` or the like.

    Args:
        file: written by torch.save.
        inputs: how many inputs the network may have.
        outputs: how many outputs it must have.

    Raises:
        InputError: if the file is no state dict of a sine network of one width and these inputs and outputs.
    """
    try:
        state = torch.load(file, map_location="cpu", weights_only=True)
    except (RuntimeError, pickle.UnpicklingError, EOFError, OSError, KeyError, ValueError) as error:
        raise InputError(
            f"{file} is not a network file, or is cut short ({type(error).__name__}): give a state dict written by "
            "torch.save, such as official/ni/kitten.pth."
        ) from error
    if not isinstance(state, dict) or not state or not all(isinstance(v, Tensor) for v in state.values()):
        raise InputError(f"{file} holds no state dict of tensors: give one, such as official/ni/kitten.pth.")
    depth = len(state) // 2
    names = [f"net.{i}.0.{kind}" for i in range(depth) for kind in ("weight", "bias")]
    if set(names) != set(state):
        if f"net.{depth - 1}.weight" in state:
            names[-2:] = [f"net.{depth - 1}.weight", f"net.{depth - 1}.bias"]
        if set(names) != set(state) or depth < 2:
            raise InputError(
                f"{file} has the keys {', '.join(list(state)[:3])}, …, which are not those of a published sine "
                "network: they should be net.0.0.weight, net.0.0.bias, net.1.0.weight and so on."
            )
    return _checked(file, [state[name].float() for name in names], inputs, outputs)


def _checked(file: Path, layers: list[Tensor], inputs: Collection[int], outputs: int) -> list[Tensor]:
    weights, biases = layers[::2], layers[1::2]
    found, width = (weights[0].shape[1], weights[0].shape[0]) if weights[0].ndim == 2 else (0, 0)
    if found not in inputs:
        kind = ": it is a trained morph, whose fourth input is time" if found == 4 else ""
        raise InputError(f"{file} has {found} inputs{kind}; give a network of {' or '.join(map(str, inputs))} inputs.")
    expected = [(width, found), *[(width, width)] * (len(weights) - 2), (outputs, width)]
    shapes = [tuple(w.shape) for w in weights]
    if shapes != expected or any(b.shape != w.shape[:1] for w, b in zip(weights, biases, strict=True)):
        raise InputError(
            f"{file} has layers of shapes {shapes}, but a network of one width and "
            f"{'one output' if outputs == 1 else f'{outputs} outputs'} was expected: {expected}."
        )
    if not all(bool(t.isfinite().all()) for t in layers):
        raise InputError(f"{file} holds weights that are not finite: get a fresh copy of it.")
    return layers


@torch.no_grad()
def _probe(network: ScalarSiren, name: str, omega: float) -> Float[Tensor, "n d"]:
    """Points on the surface of a freshly loaded network, after a check that it is a signed distance in [-1, 1]^d.

    A file does not say its ω. With a wrong one the values are no distances: no zero set, or |∇g| far from 1.
    """
    dim, n = network.in_features, _PROBE_RESOLUTION[network.in_features]
    axis = torch.linspace(-1, 1, n)
    grid = torch.stack(torch.meshgrid(*[axis] * dim, indexing="ij"), -1).reshape(-1, dim)
    values = torch.cat([network(chunk) for chunk in grid.split(32768)])
    cell = 2 / (n - 1)
    near = grid[values.abs() < cell]
    if not bool((values < 0).any()) or len(near) == 0:
        raise InputError(
            f"{name} read at omega={omega:g} has no surface in [-1, 1]^{dim}: give the omega that it was trained with "
            f"(the published ones: omega={OFFICIAL_OMEGA:g})."
        )
    near = near[:: max(1, len(near) // _PROBE_POINTS)]  # at a small omega all of the grid is near
    points, jet = newton_to_level(network.jet, near, reach=cell)
    norms = jet.gradient.norm(dim=1)
    deviation = float((norms - 1).abs().mean())
    if not deviation < EIKONAL_TOLERANCE:
        raise InputError(
            f"{name} read at omega={omega:g} is no signed distance: the length of its gradient on the surface is "
            f"{float(norms.mean()):.2f} ± {deviation:.2f} instead of 1, so give the omega that it was trained with "
            f"(the published ones: omega={OFFICIAL_OMEGA:g})."
        )
    outer = (grid.abs().amax(1) > 1 - cell / 2) & (values < 0)
    if bool(outer.any()):
        least = float(values[outer].min())
        raise InputError(
            f"{name} read at omega={omega:g} reaches the faces of [-1, 1]^{dim} (its least value is {least:.3g}), "
            "so its surface is cut: give a network whose shape lies inside, or the omega it was trained with."
        )
    return points[jet.value.abs() < 0.01 * cell]
