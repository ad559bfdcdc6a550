"""Sine networks (SIREN: Sitzmann et al., NeurIPS 2020), scalar and vector valued."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm import calculus
from nsm.cli.errors import InputError
from nsm.fields.init import siren_init_
from nsm.fields.scalar import ScalarNetwork
from nsm.types import Jet, VectorJet


class Siren(nn.Module):
    """A fully connected network with sine activations, h_l = sin(ω_l (W_l h_{l-1} + b_l)), linear at the end.

    Args:
        in_features: number of inputs k (space, or space and time last).
        out_features: number of outputs m.
        hidden_features: width of the hidden layers.
        hidden_layers: how many there are (the paper: 6 of 128).
        omega: frequency ω_l, one for all hidden layers or one each.
        first_omega: another ω_1, which sets the frequencies that the network starts with: a signed distance needs
            low ones, and an optimiser's step moves the first layer the farther the higher it is.

    Raises:
        InputError: if ``omega`` is a sequence of another length than ``hidden_layers``.
    """

    def __init__(
        self,
        in_features: int,
        out_features: int,
        hidden_features: int = 128,
        hidden_layers: int = 6,
        omega: float | Sequence[float] = 30.0,
        first_omega: float | None = None,
    ) -> None:
        super().__init__()
        omegas = [float(omega)] * hidden_layers if isinstance(omega, (int, float)) else [float(w) for w in omega]
        if len(omegas) != hidden_layers:
            raise InputError(
                f"omega has {len(omegas)} values for {hidden_layers} hidden layers: give one number, or one a layer"
            )
        self.in_features, self.out_features = in_features, out_features
        self.hidden_features, self.hidden_layers = hidden_features, hidden_layers
        if first_omega is not None and omegas:
            omegas[0] = float(first_omega)
        self.omegas = omegas
        widths = [in_features, *[hidden_features] * hidden_layers, out_features]
        self.linears = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))
        siren_init_(self)

    @property
    def linear_layers(self) -> list[nn.Linear]:
        """The layers from the first to the last, with their own, unfolded weights."""
        return list(cast("Iterable[nn.Linear]", self.linears))

    @property
    def layers(self) -> calculus.Layers:
        """Weights and biases with ω folded in, (ω W_1, ω b_1, …, W, b), as `nsm.calculus` takes them."""
        folded: list[Tensor] = []
        for linear, omega in zip(self.linear_layers, [*self.omegas, 1.0], strict=True):
            folded += [omega * linear.weight, omega * linear.bias]
        return tuple(folded)

    @torch.no_grad()
    def load_layers(self, layers: calculus.Layers) -> None:
        """Take over folded weights and biases (as `layers` gives them), so that the function is theirs, to rounding."""
        for i, (linear, omega) in enumerate(zip(self.linear_layers, [*self.omegas, 1.0], strict=True)):
            linear.weight.copy_(layers[2 * i] / omega)
            linear.bias.copy_(layers[2 * i + 1] / omega)


class ScalarSiren(Siren, ScalarNetwork):
    """A `Siren` with one output, a scalar field."""

    def __init__(
        self,
        in_features: int,
        hidden_features: int = 128,
        hidden_layers: int = 6,
        omega: float | Sequence[float] = 30.0,
        first_omega: float | None = None,
    ) -> None:
        super().__init__(in_features, 1, hidden_features, hidden_layers, omega, first_omega)

    def forward(self, x: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        """Value (n,) at x (n, k)."""
        return calculus.value(self.layers, x)[:, 0]

    def jet(self, x: Float[Tensor, "n k"]) -> Jet:
        """Value (n,) and gradient (n, k) at x (n, k)."""
        return calculus.value_and_gradient(self.layers, x)

    def hessian(self, x: Float[Tensor, "n k"], directions: int) -> Float[Tensor, "n directions k"]:
        """Second derivatives (n, directions, k), one of the two along the first inputs, at x (n, k)."""
        return calculus.value_gradient_and_hessian(self.layers, x, directions)[1]


class VectorSiren(Siren):
    """A `Siren` with several outputs, a vector field."""

    def forward(self, x: Float[Tensor, "n k"]) -> Float[Tensor, "n m"]:
        """Value (n, m) at x (n, k)."""
        return calculus.value(self.layers, x)

    def jet(self, x: Float[Tensor, "n k"], directions: int) -> VectorJet:
        """Value (n, m) and Jacobian (n, m, directions) with respect to the first inputs, at x (n, k)."""
        return calculus.value_and_jacobian(self.layers, x, directions)

    def jet_and_laplacian(self, x: Float[Tensor, "n k"], directions: int) -> tuple[VectorJet, Tensor]:
        """The jet, and the Laplacian (n, m) over the first inputs, at x (n, k)."""
        return calculus.value_jacobian_and_laplacian(self.layers, x, directions)
