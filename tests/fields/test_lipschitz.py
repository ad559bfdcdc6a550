"""Networks with a learned Lipschitz bound."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from nsm.fields import (
    LipschitzMlp,
)


def points(n: int, dim: int) -> Tensor:
    """Points (n, d + 1) of space-time."""
    return torch.rand(n, dim + 1, dtype=torch.float64) * 2 - 1


@pytest.mark.parametrize("dim", [2, 3])
def test_a_lipschitz_network_never_rises_faster_than_its_bound(dim: int) -> None:
    network = LipschitzMlp(dim + 1, 16, 3).double()
    with torch.no_grad():
        network.raw_bounds.sub_(0.7)  # so that rows are scaled down
    p, q = points(4000, dim), points(4000, dim)
    rise = (network(p) - network(q)).abs() / (p - q).abs().amax(1)
    slope = network.jet(p).gradient.abs().sum(1)  # the dual norm of the gradient is the local Lipschitz constant
    assert rise.max() <= network.bound
    assert slope.max() <= network.bound
    assert slope.max() > 1e-3 * network.bound


def test_the_bounds_of_a_lipschitz_network_start_as_the_norms_of_its_weights() -> None:
    network = LipschitzMlp(4, 16, 3).double()
    norms = torch.stack([weight.abs().sum(1).max() for weight in network.weights])
    torch.testing.assert_close(torch.nn.functional.softplus(network.raw_bounds), norms)
    torch.testing.assert_close(list(network.layers[::2]), list(network.weights))


def test_a_lipschitz_network_has_the_gradient_of_its_value_and_trains_every_weight() -> None:
    network, p = LipschitzMlp(4, 16, 3).double(), points(9, 3).requires_grad_()
    gradient = network.jet(p).gradient
    torch.testing.assert_close(gradient, torch.autograd.grad(network(p).sum(), p)[0])
    with torch.no_grad():
        network.raw_bounds.sub_(0.7)
    jet = network.jet(p)
    (jet.value.square().sum() + jet.gradient.square().sum() + network.bound).backward()
    assert all(parameter.grad is not None and parameter.grad.abs().sum() > 0 for parameter in network.parameters())
