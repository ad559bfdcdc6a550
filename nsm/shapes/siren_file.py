"""Files of signed distance networks, as the published ones are."""

from __future__ import annotations

import pickle
from collections.abc import Collection, Sequence
from pathlib import Path

import torch
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.fields.siren import ScalarSiren, Siren
from nsm.geometry.projection import newton_to_level
from nsm.shapes.base import working_box
from nsm.shapes.download import file_sha256, resolve
from nsm.shapes.primitive import Pose
from nsm.shapes.similarity import Similarity
from nsm.shapes.siren import SirenShape

#: ω of every layer of the published signed distance networks (camillebnm/neural_shape_morphing).
OFFICIAL_OMEGA = 60.0
#: Largest mean of | |∇g| − 1 | on the surface of a network that passes for a signed distance. The published ones
#: have at most 0.09, and at least 0.16 when read at an ω that is 8 % off.
EIKONAL_TOLERANCE = 0.15
#: Points along a side of the grid on which a loaded network is looked at.
_PROBE_RESOLUTION = {2: 256, 3: 48}
#: At least this many of the points near the surface are looked at, where there are so many.
_PROBE_POINTS = 10000


class SirenFile(SirenShape):
    """A published network: a state dict ``net.0.0.weight``, ``net.0.0.bias``, … without architecture or ω.

    It was trained in [-1, 1]^d.

    Args:
        path: a file, or a public name such as ``official/ni/kitten.pth``.
        omega: ω of every hidden layer, which the file does not say (60 for all the published ones).
        pose: rotation, translation and scale given to the shape.
        up: the direction in the coordinates of the file that becomes +y, before the pose; None if it is +y already.

    Raises:
        InputError: if the file holds no such network, or what it holds is no signed distance in [-1, 1]^d.
    """

    def __init__(
        self, path: str, omega: float = OFFICIAL_OMEGA, pose: Pose = None, up: Sequence[float] | None = None
    ) -> None:
        file = resolve(path)
        weights = read_layers(file)
        dim, width, hidden = weights[0].shape[1], weights[0].shape[0], len(weights) // 2 - 1
        origin = {"kind": "network", "path": str(path), "sha256": file_sha256(file), "omega": float(omega)}
        similarity = Similarity.read(pose, dim).after(Similarity.upright(up, dim))
        super().__init__(dim, width, hidden, omega, similarity, origin, similarity, working_box(dim).tolist())
        set_layers_(self.network, weights)
        _require_distance(self.network, str(path), float(omega))


@torch.no_grad()
def set_layers_(network: Siren, layers: Sequence[Tensor]) -> None:
    """Give a network the weights and biases, in order, that `read_layers` read."""
    for linear, weight, bias in zip(network.linear_layers, layers[::2], layers[1::2], strict=True):
        linear.weight.copy_(weight)
        linear.bias.copy_(bias)


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
def _require_distance(network: ScalarSiren, name: str, omega: float) -> None:
    """Raise an `InputError` unless a freshly loaded network is a signed distance in [-1, 1]^d.

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
    _, jet = newton_to_level(network.jet, near, reach=cell)
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
