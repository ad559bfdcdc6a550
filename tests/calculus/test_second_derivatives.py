"""Second-order propagation and the differential operators, against nested torch.func in float64."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.func import functional_call, hessian, jacrev, vmap

from nsm import calculus
from nsm.fields import VectorSiren


def network(inputs: int, outputs: int) -> VectorSiren:
    return VectorSiren(inputs, outputs, hidden_features=7, hidden_layers=3, omega=3.0).double()


def points(n: int, inputs: int) -> Tensor:
    return torch.rand(n, inputs, dtype=torch.float64) * 2 - 1


def oracle(net: VectorSiren, parameters: dict[str, Tensor], x: Tensor, directions: int) -> Tensor:
    """The Laplacian (n, m) as the trace of Hessians."""

    def at(point: Tensor) -> Tensor:
        return functional_call(net, parameters, (point[None],))[0]

    return vmap(hessian(at))(x)[:, :, :directions, :directions].diagonal(dim1=2, dim2=3).sum(2)


@pytest.mark.parametrize(("inputs", "directions"), [(2, 2), (3, 2), (4, 3)])
def test_value_jacobian_and_laplacian_are_those_of_nested_differentiation(inputs: int, directions: int) -> None:
    net, x = network(inputs, 4), points(6, inputs)
    jet, laplacian = calculus.value_jacobian_and_laplacian(net.layers, x, directions)
    torch.testing.assert_close(jet.value, net(x))
    torch.testing.assert_close(jet.jacobian, vmap(jacrev(lambda p: net(p[None])[0]))(x)[:, :, :directions])
    torch.testing.assert_close(laplacian, oracle(net, dict(net.named_parameters()), x, directions))


def test_the_laplacian_can_be_trained_on() -> None:
    net, x = network(3, 2), points(5, 3).requires_grad_()
    _, laplacian = calculus.value_jacobian_and_laplacian(net.layers, x, 2)
    weights = torch.randn(5, 2, dtype=torch.float64)
    ours = torch.autograd.grad((weights * laplacian).sum(), [x, *net.parameters()], materialize_grads=True)
    expected = (weights * oracle(net, dict(net.named_parameters()), x, 2)).sum()
    theirs = torch.autograd.grad(expected, [x, *net.parameters()], materialize_grads=True)
    for a, b in zip(ours, theirs, strict=True):
        torch.testing.assert_close(a, b)
    assert all(g.abs().sum() > 0 for g in ours[:-1])  # the last bias alone is lost by differentiation


@pytest.mark.parametrize(("inputs", "directions"), [(2, 2), (3, 2), (4, 3)])
def test_the_hessian_of_a_scalar_network_is_that_of_nested_differentiation(inputs: int, directions: int) -> None:
    net, x = network(inputs, 1), points(6, inputs)
    jet, second = calculus.value_gradient_and_hessian(net.layers, x, directions)
    torch.testing.assert_close(jet.value, net(x)[:, 0])
    torch.testing.assert_close(jet.gradient, vmap(jacrev(lambda p: net(p[None])[0, 0]))(x))
    torch.testing.assert_close(second, vmap(hessian(lambda p: net(p[None])[0, 0]))(x)[:, :directions])


def test_divergence_is_the_trace_of_the_jacobian() -> None:
    jacobian = torch.randn(5, 3, 3, dtype=torch.float64)
    torch.testing.assert_close(calculus.divergence(jacobian), vmap(torch.trace)(jacobian))


def solenoidal(net: VectorSiren, dim: int, point: Tensor) -> Tensor:
    """The divergence-free field (d,) at one point, by torch.func inside."""
    jacobian = jacrev(lambda p: net(p[None])[0])(point)[:, :dim]
    return calculus.antisymmetric_divergence(jacobian[None])[0]


@pytest.mark.parametrize("dim", [2, 3])
def test_the_divergence_of_an_antisymmetric_matrix_field_has_no_divergence(dim: int) -> None:
    net, x = network(dim + 1, calculus.potential_count(dim)), points(20, dim + 1)
    gradient = vmap(jacrev(lambda p: solenoidal(net, dim, p)))(x)[:, :, :dim]
    assert gradient.abs().max() > 0.01
    assert calculus.divergence(gradient).abs().max() < 1e-13 * gradient.abs().max() * 10


def test_in_three_dimensions_it_is_the_curl() -> None:
    jacobian = torch.randn(5, 3, 3, dtype=torch.float64)
    d = jacobian.permute(1, 2, 0)  # d[i, j] = ∂_j D_i
    curl = torch.stack([d[2, 1] - d[1, 2], d[0, 2] - d[2, 0], d[1, 0] - d[0, 1]], dim=1)
    torch.testing.assert_close(calculus.antisymmetric_divergence(jacobian), curl, rtol=0, atol=0)


def test_in_two_dimensions_it_is_the_skew_gradient() -> None:
    jacobian = torch.randn(5, 1, 2, dtype=torch.float64)
    skew = torch.stack([jacobian[:, 0, 1], -jacobian[:, 0, 0]], dim=1)
    torch.testing.assert_close(calculus.antisymmetric_divergence(jacobian), skew, rtol=0, atol=0)


@pytest.mark.parametrize(("dim", "count"), [(2, 1), (3, 3), (4, 6)])
def test_an_antisymmetric_matrix_has_as_many_potentials_as_pairs(dim: int, count: int) -> None:
    assert calculus.potential_count(dim) == count
