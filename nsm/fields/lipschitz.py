"""Networks with a learned bound on their Lipschitz constant."""

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
    """A tanh network in which every layer has a learned bound softplus(c_l) on its Lipschitz constant.

    Rows of W_l whose absolute sum exceeds the bound are scaled down to it,

        Ŵ_l = W_l min(1, softplus(c_l) / Σ_j |W_lij|),

    so that ‖Ŵ_l‖_∞ ≤ softplus(c_l) and |f(p) − f(q)| ≤ Π_l softplus(c_l) · ‖p − q‖_∞ for all p and q. Each c_l is
    initialized so that the bound equals the norm of W_l, so no row is scaled at first.

    Args:
        in_features: Number of inputs k: the coordinates of space, followed by time where there is one.
        hidden_features: Width of the hidden layers.
        hidden_layers: Number of hidden layers.

    References:
        Liu et al., Learning Smooth Neural Functions via Lipschitz Regularization, SIGGRAPH 2022, section 5.
        https://arxiv.org/abs/2202.08345

    Example:
        >>> import torch
        >>> from nsm.fields import LipschitzMlp
        >>> field = LipschitzMlp(in_features=4, hidden_features=16, hidden_layers=2)
        >>> p, q = torch.rand(100, 4), torch.rand(100, 4)
        >>> bool(((field(p) - field(q)).abs() <= field.bound * (p - q).abs().amax(1) + 1e-5).all())
        True
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
    def bound(self) -> Float[Tensor, ""]:
        """Bound Π_l softplus(c_l) on the Lipschitz constant of the network in the ∞-norm."""
        return F.softplus(self.raw_bounds).prod()

    @property
    def layers(self) -> calculus.Layers:
        """Scaled weights and biases, (Ŵ_1, b_1, …), as `nsm.calculus` takes them."""
        scaled: list[Tensor] = []
        for weight, bias, bound in zip(self.weights, self.biases, F.softplus(self.raw_bounds), strict=True):
            sums = weight.abs().sum(1, keepdim=True)
            scaled += [weight * (bound / sums).clamp(max=1.0), bias]
        return tuple(scaled)

    def forward(self, x: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        return self.jet(x).value

    def jet(self, x: Float[Tensor, "n k"]) -> Jet:
        return calculus.tanh_value_and_gradient(self.layers, x)
