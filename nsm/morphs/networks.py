"""The networks of a morph as `nsm.types.Networks`, for programs that do not have nsm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

import nsm
from nsm.cli.errors import InputError
from nsm.fields import Beta, LearnedVelocity, LipschitzMlp, ScalarNetwork, Siren, Velocity
from nsm.types import Networks

#: Version of the description, raised when readers of older files can no longer read it.
FORMAT = 1
#: Activation between the layers of each kind of network.
_ACTIVATIONS: dict[type[nn.Module], str] = {Siren: "sin", LipschitzMlp: "tanh"}
_OUTPUTS = ("signed_distance", "gradient", "velocity")


class FieldProgram(nn.Module):
    """f, ∇f, and V of two networks as one function of points and times.

    Args:
        field: Network of f.
        velocity: V, or None for a morph without a velocity field.
    """

    def __init__(self, field: ScalarNetwork, velocity: Velocity | None) -> None:
        super().__init__()
        self.field, self.velocity = field, velocity

    def forward(self, points: Float[Tensor, "n d"], time: Float[Tensor, " n"]) -> tuple[Tensor, ...]:
        """f (n,), ∇f (n, d), and V (n, d) if there is a velocity field."""
        p = torch.cat([points, time[:, None]], 1)
        jet = self.field.jet(p)
        outputs = (jet.value, jet.gradient[:, : points.shape[1]])
        return outputs if self.velocity is None else (*outputs, self.velocity(p, jet))


def portable_networks(
    field: ScalarNetwork, velocity: Velocity | None, bounds: Float[Tensor, "2 d"], shapes: Mapping[str, Any]
) -> Networks:
    """Describe two networks, and fold ω into their weights.

    Args:
        field: Network of f in single precision on the CPU, which is changed.
        velocity: V, or None; changed likewise.
        bounds: Corners of the box of the morph, shape (2, d).
        shapes: Provenance of the ``source`` and the ``target``.

    Raises:
        InputError: If a network is of a kind that has no layers of its own.
    """
    dim = bounds.shape[1]
    description = {
        "format": FORMAT,
        "nsm": nsm.__version__,
        "dim": dim,
        "bounds": bounds.tolist(),
        "inputs": {"points": ["n", dim], "time": ["n"]},
        "outputs": list(_OUTPUTS if velocity else _OUTPUTS[:2]),
        "grown": False,
        "symmetry": field.symmetry,
        "field": _architecture(field.core),
        "velocity": None if velocity is None else _describe_velocity(velocity.core),
        **shapes,
    }
    program = FieldProgram(field, velocity)
    for module in program.modules():
        if isinstance(module, Siren):
            folded = module.layers
            module.omegas = [1.0] * module.hidden_layers
            module.load_layers(folded)
    return Networks(program, description, _weights(program))


def _weights(program: FieldProgram) -> dict[str, Tensor] | None:
    """Layers of both networks by name; None where f or V is a formula, such as a mean over mirror images."""
    if program.field.symmetry or not isinstance(program.velocity, LearnedVelocity | None):
        return None
    parts: dict[str, nn.Module] = {"field": program.field}
    if program.velocity is not None:
        parts["velocity"] = program.velocity.network
    return {
        f"{part}.{number // 2}.{('weight', 'bias')[number % 2]}": layer.detach().contiguous()
        for part, network in parts.items()
        for number, layer in enumerate(_layered(network).layers)
    }


def _describe_velocity(velocity: Velocity) -> dict[str, Any]:
    described: dict[str, Any] = {"kind": type(velocity).__name__, **_numbers(velocity)}
    if isinstance(velocity, LearnedVelocity):
        described["network"] = _architecture(velocity.network)
    for beta in velocity.children():
        if isinstance(beta, Beta):
            described["beta"] = {"kind": type(beta).__name__, **_numbers(beta)}
    return described


def _layered(network: nn.Module) -> Siren | LipschitzMlp:
    if not isinstance(network, tuple(_ACTIVATIONS)):
        raise InputError(
            f"`field` and `velocity` must be sine or Lipschitz networks to be exported, got {type(network).__name__}. "
            "Try a morph trained with `field=siren`."
        )
    return cast("Siren | LipschitzMlp", network)


def _architecture(network: nn.Module) -> dict[str, Any]:
    layered = _layered(network)
    widths = [layered.layers[0].shape[1], *(len(bias) for bias in layered.layers[1::2])]
    activation = next(name for kind, name in _ACTIVATIONS.items() if isinstance(network, kind))
    return {
        "kind": type(network).__name__,
        "widths": widths,
        "activation": activation,
        "omega": list(layered.omegas) if isinstance(layered, Siren) else None,  # already folded into the weights
    }


def _numbers(module: nn.Module) -> dict[str, float]:
    values: Mapping[str, Any] = vars(module)
    return {name: value for name, value in values.items() if isinstance(value, float)}
