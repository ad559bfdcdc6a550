"""Closed-form derivatives of sine networks agree with automatic differentiation, and so do their adjoints."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch
from torch import Tensor
from torch.func import jacrev, vmap

from nsm import calculus

WIDTH = 7
DEPTHS = [1, 2, 4]
INPUTS = [2, 3, 4]


def random_layers(inputs: int, outputs: int, depth: int) -> calculus.Layers:
    """Weights and biases of a network with ``depth`` hidden layers, in float64, large enough to bend the sines."""
    widths = [inputs, *[WIDTH] * depth, outputs]
    layers: list[Tensor] = []
    for fan_in, fan_out in pairwise(widths):
        layers += [torch.randn(fan_out, fan_in).double() * 1.5 / fan_in**0.5, torch.randn(fan_out).double()]
    return tuple(layers)


def points(n: int, inputs: int) -> Tensor:
    return torch.rand(n, inputs, dtype=torch.float64) * 2 - 1


def network_at(layers: calculus.Layers, point: Tensor) -> Tensor:
    """The network written naively for one point (k,) -> (m,), the oracle of this file."""
    h = point
    for weight, bias in zip(layers[:-2:2], layers[1:-2:2], strict=True):
        h = torch.sin(weight @ h + bias)
    return layers[-2] @ h + layers[-1]


def oracle(layers: calculus.Layers, x: Tensor) -> tuple[Tensor, Tensor]:
    """Value (n, m) and Jacobian (n, m, k) by automatic differentiation."""
    value = vmap(lambda point: network_at(layers, point))(x)
    jacobian = vmap(jacrev(lambda point: network_at(layers, point)))(x)
    return value, jacobian


def with_gradients(*tensors: Tensor) -> tuple[Tensor, ...]:
    return tuple(t.clone().requires_grad_() for t in tensors)


@pytest.mark.parametrize("depth", DEPTHS)
@pytest.mark.parametrize("inputs", INPUTS)
def test_value_agrees_with_the_network_written_naively(inputs: int, depth: int) -> None:
    layers, x = random_layers(inputs, 3, depth), points(11, inputs)
    torch.testing.assert_close(calculus.value(layers, x), oracle(layers, x)[0])


@pytest.mark.parametrize("depth", DEPTHS)
@pytest.mark.parametrize("inputs", INPUTS)
def test_gradient_of_a_scalar_network_agrees_with_reverse_mode(inputs: int, depth: int) -> None:
    layers, x = random_layers(inputs, 1, depth), points(11, inputs)
    jet = calculus.value_and_gradient(layers, x)
    value, jacobian = oracle(layers, x)
    torch.testing.assert_close(jet.value, value[:, 0])
    torch.testing.assert_close(jet.gradient, jacobian[:, 0])


@pytest.mark.parametrize("depth", DEPTHS)
@pytest.mark.parametrize("outputs", [1, 3, 4])
@pytest.mark.parametrize(("inputs", "directions"), [(2, 1), (2, 2), (3, 2), (3, 3), (4, 1), (4, 3), (4, 4)])
def test_jacobian_of_a_vector_network_agrees_with_reverse_mode(
    inputs: int, directions: int, outputs: int, depth: int
) -> None:
    layers, x = random_layers(inputs, outputs, depth), points(11, inputs)
    jet = calculus.value_and_jacobian(layers, x, directions)
    value, jacobian = oracle(layers, x)
    torch.testing.assert_close(jet.value, value)
    torch.testing.assert_close(jet.jacobian, jacobian[:, :, :directions])


@pytest.mark.parametrize("inputs", INPUTS)
def test_both_sweeps_agree_on_a_network_with_one_output(inputs: int) -> None:
    layers, x = random_layers(inputs, 1, 3), points(11, inputs)
    scalar, vector = calculus.value_and_gradient(layers, x), calculus.value_and_jacobian(layers, x, inputs)
    torch.testing.assert_close(scalar.value, vector.value[:, 0])
    torch.testing.assert_close(scalar.gradient, vector.jacobian[:, 0])


@pytest.mark.parametrize("depth", DEPTHS)
@pytest.mark.parametrize("inputs", INPUTS)
def test_adjoint_of_the_scalar_sweep_is_exact_in_points_and_weights(inputs: int, depth: int) -> None:
    x, *layers = with_gradients(points(3, inputs), *random_layers(inputs, 1, depth))
    assert torch.autograd.gradcheck(lambda x, *w: tuple(calculus.value_and_gradient(w, x)), (x, *layers))


@pytest.mark.parametrize("depth", DEPTHS)
@pytest.mark.parametrize(("inputs", "directions"), [(2, 2), (3, 3), (4, 3)])
def test_adjoint_of_the_tangent_sweep_is_exact_in_points_and_weights(inputs: int, directions: int, depth: int) -> None:
    x, *layers = with_gradients(points(3, inputs), *random_layers(inputs, 4, depth))
    assert torch.autograd.gradcheck(lambda x, *w: tuple(calculus.value_and_jacobian(w, x, directions)), (x, *layers))


def eikonal_loss(value: Tensor, gradient: Tensor) -> Tensor:
    return value.square().mean() + (gradient.norm(dim=-1) - 1).square().mean()


def test_a_loss_on_value_and_gradient_has_the_gradients_of_nested_automatic_differentiation() -> None:
    x, *layers = with_gradients(points(20, 4), *random_layers(4, 1, 3))
    ours = torch.autograd.grad(eikonal_loss(*calculus.value_and_gradient(tuple(layers), x)), [x, *layers])
    value, jacobian = oracle(tuple(layers), x)
    theirs = torch.autograd.grad(eikonal_loss(value[:, 0], jacobian[:, 0]), [x, *layers])
    torch.testing.assert_close(ours, theirs)


def test_a_loss_on_the_divergence_has_the_gradients_of_nested_automatic_differentiation() -> None:
    x, *layers = with_gradients(points(20, 4), *random_layers(4, 3, 3))
    jacobian = calculus.value_and_jacobian(tuple(layers), x, 3).jacobian
    ours = torch.autograd.grad(jacobian.diagonal(dim1=1, dim2=2).sum(1).square().mean(), [x, *layers[:-1]])
    jacobian = oracle(tuple(layers), x)[1][:, :, :3]
    theirs = torch.autograd.grad(jacobian.diagonal(dim1=1, dim2=2).sum(1).square().mean(), [x, *layers[:-1]])
    torch.testing.assert_close(ours, theirs)


@pytest.mark.parametrize("part", [0, 1])
def test_a_loss_on_one_part_of_a_jet_leaves_the_other_out(part: int) -> None:
    x, *layers = with_gradients(points(5, 3), *random_layers(3, 1, 2))
    ours = torch.autograd.grad(calculus.value_and_gradient(tuple(layers), x)[part].sum(), [x, *layers[:-1]])
    theirs = torch.autograd.grad(
        oracle(tuple(layers), x)[part].sum(), [x, *layers[:-1]], allow_unused=True, materialize_grads=True
    )
    torch.testing.assert_close(ours, theirs)


@pytest.mark.parametrize("outputs", [1, 3])
def test_weights_get_the_same_gradient_whether_or_not_points_need_one(outputs: int) -> None:
    x, layers = points(9, 3), with_gradients(*random_layers(3, outputs, 2))

    def gradients(x: Tensor) -> tuple[Tensor, ...]:
        scalar = outputs == 1
        jet = calculus.value_and_gradient(layers, x) if scalar else calculus.value_and_jacobian(layers, x, directions=2)
        return torch.autograd.grad(jet[0].sum() + jet[1].square().sum(), layers)

    torch.testing.assert_close(gradients(x), gradients(x.clone().requires_grad_()), rtol=0, atol=0)


@pytest.mark.parametrize("n", [0, 1])
def test_no_point_and_one_point_are_batches_too(n: int) -> None:
    scalar, vector = with_gradients(*random_layers(4, 1, 2)), with_gradients(*random_layers(4, 3, 2))
    x = points(n, 4)
    jet, vector_jet = calculus.value_and_gradient(scalar, x), calculus.value_and_jacobian(vector, x, 3)
    assert jet.value.shape == (n,)
    assert jet.gradient.shape == (n, 4)
    assert vector_jet.value.shape == (n, 3)
    assert vector_jet.jacobian.shape == (n, 3, 3)
    for layers, parts in ((scalar, jet), (vector, vector_jet)):
        gradients = torch.autograd.grad(parts[0].sum() + parts[1].sum(), layers)
        assert [g.shape for g in gradients] == [w.shape for w in layers]
        assert n or not any(g.any() for g in gradients)


def test_points_are_evaluated_independently_of_their_batch() -> None:
    layers, x = random_layers(4, 1, 3), points(30, 4)
    whole, halves = (
        calculus.value_and_gradient(layers, x).gradient,
        torch.cat([calculus.value_and_gradient(layers, half).gradient for half in (x[:13], x[13:])]),
    )
    torch.testing.assert_close(whole, halves, rtol=1e-12, atol=1e-12)


def test_points_may_lie_apart_in_memory() -> None:
    layers, x = random_layers(3, 1, 2), points(8, 6)[:, ::2]
    torch.testing.assert_close(calculus.value_and_gradient(layers, x), calculus.value_and_gradient(layers, x.clone()))


def test_sweeps_leave_points_and_weights_as_they_were() -> None:
    x, *layers = with_gradients(points(6, 4), *random_layers(4, 1, 2))
    before = [t.detach().clone() for t in (x, *layers)]
    for jet in (calculus.value_and_gradient(tuple(layers), x), calculus.value_and_jacobian(tuple(layers), x, 3)):
        (jet[0].sum() + jet[1].square().sum()).backward()
    torch.testing.assert_close([t.detach() for t in (x, *layers)], before, rtol=0, atol=0)
