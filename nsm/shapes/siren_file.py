"""Signed distance networks from files in the format of the paper's authors."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import torch
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.fields.siren import ScalarSiren, Siren
from nsm.geometry.projection import newton_to_level
from nsm.shapes.base import working_box
from nsm.shapes.download import file_sha256, resolve
from nsm.shapes.similarity import Pose, Similarity
from nsm.shapes.siren import SirenShape
from nsm.shapes.torch_files import is_state_dict, load_torch

#: ω of all layers of the published networks, https://github.com/camillebnm/neural_shape_morphing
OFFICIAL_OMEGA = 60.0
#: Maximum mean of |‖∇g‖ − 1| on the surface of a signed distance. The published networks have at most 0.09, and at
#: least 0.16 if ω is wrong by 8 %.
_EIKONAL_TOLERANCE = 0.15
#: Number of points along a side of the grid on which a network from a file is checked, by dimension.
_CHECK_RESOLUTION = {2: 256, 3: 48}
#: Approximate maximum number of points near the surface that are checked.
_CHECK_POINTS = 10000


class SirenFile(SirenShape):
    """A network from a file in the published format, trained in [-1, 1]^d.

    The file is a state dict with the keys ``net.0.0.weight``, ``net.0.0.bias``, …, and contains neither architecture
    nor ω.

    Args:
        path: A file, or a public name such as ``official/ni/kitten.pth``.
        omega: Frequency ω of all hidden layers, 60 for the published networks.
        pose: Rotation, translation, and scale applied to the shape.
        up: Direction in the coordinates of the file that becomes +y, before the pose; None for +y.

    Raises:
        InputError: If the file contains no such network, or the network is not a signed distance in [-1, 1]^d.
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
    """Copy weights and biases from `read_layers` to a network."""
    for linear, weight, bias in zip(network.linear_layers, layers[::2], layers[1::2], strict=True):
        linear.weight.copy_(weight)
        linear.bias.copy_(bias)


def read_layers(file: Path, inputs: Collection[int] = (2, 3), outputs: int = 1) -> list[Tensor]:
    """Read weights and biases in single precision from a state dict with keys such as ``net.0.0.weight``.

    Args:
        file: A file written by ``torch.save``.
        inputs: Admissible numbers of inputs.
        outputs: Required number of outputs.

    Returns:
        Weights and biases in order, (W_1, b_1, …, W_{L+1}, b_{L+1}).

    Raises:
        InputError: If the file is not a state dict of a sine network of constant width with these inputs and outputs.
    """
    state = load_torch(file, "a state dict written by torch.save", "`path=official/ni/kitten.pth`")
    if not is_state_dict(state) or not state:
        raise InputError(
            f"`{file}` must be a state dict of tensors by name, got {type(state).__name__}. Try "
            "`path=official/ni/kitten.pth`."
        )
    depth = len(state) // 2
    names = [f"net.{i}.0.{kind}" for i in range(depth) for kind in ("weight", "bias")]
    if set(names) != set(state):
        if f"net.{depth - 1}.weight" in state:
            names[-2:] = [f"net.{depth - 1}.weight", f"net.{depth - 1}.bias"]
        if set(names) != set(state) or depth < 2:
            raise InputError(
                f"`{file}` must have the keys net.0.0.weight, net.0.0.bias, net.1.0.weight, …, got "
                f"{', '.join(list(state)[:3])}, …. Try `path=official/ni/kitten.pth` for an example."
            )
    return _checked(file, [state[name].float() for name in names], inputs, outputs)


def _checked(file: Path, layers: list[Tensor], inputs: Collection[int], outputs: int) -> list[Tensor]:
    weights, biases = layers[::2], layers[1::2]
    found, width = (weights[0].shape[1], weights[0].shape[0]) if weights[0].ndim == 2 else (0, 0)
    if found not in inputs:
        reason = ", which is a trained morph, whose fourth input is time" if found == 4 else ""
        wanted = " or ".join(map(str, inputs))
        raise InputError(
            f"`{file}` must have {wanted} inputs, got {found}{reason}. Try a network with {wanted} inputs."
        )
    expected = [(width, found), *[(width, width)] * (len(weights) - 2), (outputs, width)]
    shapes = [tuple(w.shape) for w in weights]
    if shapes != expected or any(b.shape != w.shape[:1] for w, b in zip(weights, biases, strict=True)):
        raise InputError(
            f"`{file}` must have layers of one width and {outputs} output{'s' * (outputs != 1)}, {expected}, got "
            f"{shapes}. Try `path=official/ni/kitten.pth` for an example."
        )
    if not all(bool(t.isfinite().all()) for t in layers):
        raise InputError(f"`{file}` must have finite weights, got some that are not. Try a fresh copy of the file.")
    return layers


@torch.no_grad()
def _require_distance(network: ScalarSiren, name: str, omega: float) -> None:
    """Reject a network that is not a signed distance in [-1, 1]^d.

    The file does not contain ω. With a wrong ω the network has no zero level set, or ‖∇g‖ is far from 1.
    """
    dim, n = network.in_features, _CHECK_RESOLUTION[network.in_features]
    axis = torch.linspace(-1, 1, n)
    grid = torch.stack(torch.meshgrid(*[axis] * dim, indexing="ij"), -1).reshape(-1, dim)
    values = torch.cat([network(chunk) for chunk in grid.split(32768)])
    cell = 2 / (n - 1)
    near = grid[values.abs() < cell]
    if not bool((values < 0).any()) or len(near) == 0:
        raise InputError(
            f"`omega` must be the value that {name} was trained with, got {omega:g}, with which it has no surface in "
            f"[-1, 1]^{dim}. Try `omega={OFFICIAL_OMEGA:g}`, the value of the published networks."
        )
    near = near[:: max(1, len(near) // _CHECK_POINTS)]  # with a small ω all points of the grid are near
    _, jet = newton_to_level(network.jet, near, reach=cell)
    norms = jet.gradient.norm(dim=1)
    deviation = float((norms - 1).abs().mean())
    if not deviation < _EIKONAL_TOLERANCE:
        raise InputError(
            f"`omega` must be the value that {name} was trained with, got {omega:g}, with which ‖∇g‖ on the surface is "
            f"{float(norms.mean()):.2f} ± {deviation:.2f} instead of 1. Try `omega={OFFICIAL_OMEGA:g}`, the value of "
            "the published networks."
        )
    outer = (grid.abs().amax(1) > 1 - cell / 2) & (values < 0)
    if bool(outer.any()):
        least = float(values[outer].min())
        raise InputError(
            f"`omega` must be the value that {name} was trained with, got {omega:g}, with which its surface leaves "
            f"[-1, 1]^{dim} (minimum on the faces {least:.3g}). Try `omega={OFFICIAL_OMEGA:g}`, the value of "
            "the published networks."
        )
