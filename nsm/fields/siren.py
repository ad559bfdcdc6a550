"""Networks with sine activations (SIREN), scalar-valued and vector-valued."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm import calculus
from nsm.cli.errors import InputError
from nsm.fields.scalar import ScalarNetwork
from nsm.types import Jet, VectorJet


class Siren(nn.Module):
    """A fully connected network with sine activations, h_l = sin(ω_l (W_l h_{l−1} + b_l)), and a linear last layer.

    Args:
        in_features: Number of inputs k: the coordinates of space, followed by time where there is one.
        out_features: Number of outputs m.
        hidden_features: Width of the hidden layers.
        hidden_layers: Number of hidden layers. The paper uses 6 of width 128.
        omega: Frequencies ω_l, one for all hidden layers or one for each.
        first_omega: Frequency ω_1 of the first layer if it differs. It sets the frequencies that the network starts
            with; a signed distance needs low ones, and an optimizer moves the first layer farther the higher it is.

    Raises:
        InputError: If ``omega`` is a sequence whose length is not ``hidden_layers``.

    References:
        Sitzmann et al., Implicit Neural Representations with Periodic Activation Functions, NeurIPS 2020.
        https://arxiv.org/abs/2006.09661
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
                f"`omega` must be one number or {hidden_layers} numbers, one for each hidden layer, got {len(omegas)}. "
                "Try `omega=30`."
            )
        self.in_features, self.out_features = in_features, out_features
        self.hidden_features, self.hidden_layers = hidden_features, hidden_layers
        if first_omega is not None and omegas:
            omegas[0] = float(first_omega)
        self.omegas = omegas
        widths = [in_features, *[hidden_features] * hidden_layers, out_features]
        self.linears = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))
        self.reset_parameters()

    @property
    def linear_layers(self) -> list[nn.Linear]:
        """All layers in order, with ω not folded into the weights."""
        return list(cast("Iterable[nn.Linear]", self.linears))

    @property
    def layers(self) -> calculus.Layers:
        """Weights and biases with ω folded in, (ω W_1, ω b_1, …, W, b), as `nsm.calculus` takes them."""
        folded: list[Tensor] = []
        for linear, omega in zip(self.linear_layers, [*self.omegas, 1.0], strict=True):
            folded += [omega * linear.weight, omega * linear.bias]
        return tuple(folded)

    @torch.no_grad()
    def reset_parameters(self) -> None:
        """Draw weights as the authors of SIREN do (section 3.2).

        The first layer is uniform in ±1/k for k inputs, and every later one in ±√(6/h)/ω for width h, so that the
        distribution of activations is the same in all layers. Biases are uniform in ±1/√(fan-in).
        """
        omegas = [*self.omegas, self.omegas[-1]]
        for i, (linear, omega) in enumerate(zip(self.linear_layers, omegas, strict=True)):
            fan_in = linear.in_features
            bound = 1 / fan_in if i == 0 else (6 / fan_in) ** 0.5 / omega
            linear.weight.uniform_(-bound, bound)
            linear.bias.uniform_(-(fan_in**-0.5), fan_in**-0.5)

    @torch.no_grad()
    def load_layers(self, layers: calculus.Layers) -> None:
        """Copy weights and biases with ω folded in, in the format of `layers`.

        The network then computes the same function as the one that the layers come from, to rounding, at any ω.
        """
        for i, (linear, omega) in enumerate(zip(self.linear_layers, [*self.omegas, 1.0], strict=True)):
            linear.weight.copy_(layers[2 * i] / omega)
            linear.bias.copy_(layers[2 * i + 1] / omega)


class ScalarSiren(Siren, ScalarNetwork):
    """A `Siren` with one output: a scalar field.

    Args:
        in_features: Number of inputs k: the coordinates of space, followed by time where there is one.
        hidden_features: Width of the hidden layers.
        hidden_layers: Number of hidden layers.
        omega: Frequencies ω_l, one for all hidden layers or one for each.
        first_omega: Frequency ω_1 of the first layer if it differs.

    Example:
        >>> import torch
        >>> from nsm.fields import ScalarSiren
        >>> field = ScalarSiren(in_features=4, hidden_features=16, hidden_layers=2)
        >>> value, gradient = field.jet(torch.rand(5, 4))
        >>> value.shape, gradient.shape
        (torch.Size([5]), torch.Size([5, 4]))
    """

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
        return calculus.value(self.layers, x)[:, 0]

    def jet(self, x: Float[Tensor, "n k"]) -> Jet:
        return calculus.value_and_gradient(self.layers, x)

    def hessian(self, x: Float[Tensor, "n k"], directions: int) -> Float[Tensor, "n directions k"]:
        return calculus.value_gradient_and_hessian(self.layers, x, directions)[1]


class VectorSiren(Siren):
    """A `Siren` with several outputs: a vector field.

    Example:
        >>> import torch
        >>> from nsm.fields import VectorSiren
        >>> field = VectorSiren(in_features=4, out_features=3, hidden_features=16, hidden_layers=2)
        >>> value, jacobian = field.jet(torch.rand(5, 4), directions=3)
        >>> value.shape, jacobian.shape
        (torch.Size([5, 3]), torch.Size([5, 3, 3]))
    """

    def forward(self, x: Float[Tensor, "n k"]) -> Float[Tensor, "n m"]:
        """Evaluate the field at points of shape (n, k)."""
        return calculus.value(self.layers, x)

    def jet(self, x: Float[Tensor, "n k"], directions: int) -> VectorJet:
        """Evaluate the field and its Jacobian with respect to the first ``directions`` inputs."""
        return calculus.value_and_jacobian(self.layers, x, directions)

    def jet_and_laplacian(self, x: Float[Tensor, "n k"], directions: int) -> tuple[VectorJet, Float[Tensor, "n m"]]:
        """Evaluate the field, its Jacobian, and its Laplacian with respect to the first ``directions`` inputs."""
        return calculus.value_jacobian_and_laplacian(self.layers, x, directions)
