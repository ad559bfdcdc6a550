"""Networks whose Lipschitz constant is known and can be asked to be small."""

from __future__ import annotations

from itertools import pairwise

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from nsm import calculus
from nsm.fields.scalar import ScalarNetwork
from nsm.types import Jet


class LipschitzMlp(ScalarNetwork):
    """A tanh network each of whose layers has a learned bound softplus(c_l) on its Lipschitz constant.

    A row of W_l whose absolute sum exceeds the bound is scaled down to it,
    Ŵ_l = W_l min(1, softplus(c_l) / Σ_j |W_lij|), so that ‖Ŵ_l‖_∞ ≤ softplus(c_l), and
    |f(p) − f(q)| ≤ Π_l softplus(c_l) · ‖p − q‖_∞ for all p, q (Liu et al., Learning Smooth Neural Functions via
    Lipschitz Regularization, SIGGRAPH 2022, section 5). Each c_l starts where the bound is the norm that W_l has, so
    that nothing is scaled down at first.

    Args:
        in_features: number of inputs k (space, or space and time last).
        hidden_features: width of the hidden layers.
        hidden_layers: how many there are.
    """

    def __init__(self, in_features: int, hidden_features: int = 128, hidden_layers: int = 6) -> None:
        super().__init__()
        self.in_features, self.hidden_features, self.hidden_layers = in_features, hidden_features, hidden_layers
        widths = [in_features, *[hidden_features] * hidden_layers, 1]
        self.weights = nn.ParameterList(torch.empty(b, a) for a, b in pairwise(widths))
        self.biases = nn.ParameterList(torch.zeros(b) for b in widths[1:])
        for weight in self.weights:
            nn.init.xavier_normal_(weight)
        norms = torch.stack([weight.detach().abs().sum(1).max() for weight in self.weights])
        self.raw_bounds = nn.Parameter(norms + torch.log(-torch.expm1(-norms)))

    @property
    def bound(self) -> Tensor:
        """Π_l softplus(c_l): no two values differ by more than this times the ∞-norm between their points."""
        return F.softplus(self.raw_bounds).prod()

    @property
    def layers(self) -> calculus.Layers:
        """The scaled weights and the biases, (Ŵ_1, b_1, …), as `nsm.calculus` takes them."""
        scaled: list[Tensor] = []
        for weight, bias, bound in zip(self.weights, self.biases, F.softplus(self.raw_bounds), strict=True):
            sums = weight.abs().sum(1, keepdim=True)
            scaled += [weight * (bound / sums).clamp(max=1.0), bias]
        return tuple(scaled)

    def forward(self, x: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        return self.jet(x).value

    def jet(self, x: Float[Tensor, "n k"]) -> Jet:
        return calculus.tanh_value_and_gradient(self.layers, x)
