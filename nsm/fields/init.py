"""How the networks start."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from nsm.fields.scalar import ScalarNetwork
    from nsm.fields.siren import ScalarSiren, Siren


@torch.no_grad()
def siren_init_(network: Siren) -> None:
    """Draw the weights of a sine network as its authors do (Sitzmann et al., NeurIPS 2020, section 3.2).

    The first layer is uniform in ±1/k for k inputs, every later one in ±√(6/h)/ω for width h, so that the
    activations keep their distribution from layer to layer; biases are uniform in ±1/√(fan in).
    """
    omegas = [*network.omegas, network.omegas[-1]]
    for i, (linear, omega) in enumerate(zip(network.linear_layers, omegas, strict=True)):
        fan_in = linear.in_features
        bound = 1 / fan_in if i == 0 else (6 / fan_in) ** 0.5 / omega
        linear.weight.uniform_(-bound, bound)
        linear.bias.uniform_(-(fan_in**-0.5), fan_in**-0.5)


class FieldInit(ABC):
    """Sets the first weights of f(x, t), perhaps from a network g(x) of the same width and depth for the source.

    Attributes:
        needs_source: whether g must be given.
    """

    needs_source: bool = True

    @abstractmethod
    def __call__(self, field: ScalarSiren, source: ScalarSiren | None) -> None:
        """Set the weights of ``field`` in place."""


class SirenInit(FieldInit):
    """Random weights, as every SIREN starts."""

    needs_source = False

    def __call__(self, field: ScalarSiren, source: ScalarSiren | None) -> None:
        siren_init_(field)


class SourceInit(FieldInit):
    """f(x, t) = g(x) exactly, at every t: the first level-set residual is that of a shape at rest."""

    def __call__(self, field: ScalarSiren, source: ScalarSiren | None) -> None:
        _start_from(field, source, 1.0)


class OfficialInit(FieldInit):
    """The weights of g with all frequencies lowered, as the authors' code starts: networks of ω = 60 read at 15.

    Args:
        factor: the ratio of frequencies; 15/60 in the authors' code.
    """

    def __init__(self, factor: float = 0.25) -> None:
        self.factor = float(factor)

    def __call__(self, field: ScalarSiren, source: ScalarSiren | None) -> None:
        _start_from(field, source, self.factor)


class OwnInit(FieldInit):
    """The weights that the network drew when it was made, in the way of its kind."""

    needs_source = False

    def __call__(self, field: ScalarNetwork, source: ScalarSiren | None) -> None:
        pass


def _start_from(field: ScalarSiren, source: ScalarSiren | None, factor: float) -> None:
    if source is None or (source.hidden_features, source.hidden_layers) != (field.hidden_features, field.hidden_layers):
        raise ValueError("f can only start from a network of its own width and depth: fit one to the source first")
    *hidden, weight, bias = source.layers
    hidden = [factor * parameter for parameter in hidden]
    hidden[0] = torch.cat([hidden[0], hidden[0].new_zeros(len(hidden[0]), 1)], 1)
    field.load_layers((*hidden, weight, bias))
