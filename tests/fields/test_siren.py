"""Sine networks: the function they compute, their initial weights, and how weights move between frequencies."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from nsm.fields.siren import ScalarSiren, Siren, VectorSiren


def points(n: int, inputs: int) -> Tensor:
    return torch.rand(n, inputs, dtype=torch.float64) * 2 - 1


def test_a_network_is_its_formula_with_a_frequency_for_each_layer() -> None:
    network, x = VectorSiren(3, 2, hidden_features=5, hidden_layers=3, omega=[40.0, 20.0, 5.0]).double(), points(6, 3)
    first, second, third, last = network.linears
    h = torch.sin(5.0 * third(torch.sin(20.0 * second(torch.sin(40.0 * first(x))))))
    torch.testing.assert_close(network(x), last(h))


def test_one_frequency_means_the_same_for_all_layers() -> None:
    one = ScalarSiren(3, 8, 3, omega=15)
    each = ScalarSiren(3, 8, 3, omega=[15, 15, 15])
    each.load_state_dict(one.state_dict())
    x = points(6, 3).float()
    torch.testing.assert_close(one(x), each(x), rtol=0, atol=0)


def test_a_list_of_frequencies_must_have_one_for_each_layer() -> None:
    with pytest.raises(ValueError, match="`omega` must be one number or 3 numbers, one for each hidden layer, got 2"):
        ScalarSiren(3, 8, 3, omega=[30.0, 10.0])


def test_scalar_fields_have_no_trailing_axis() -> None:
    network = ScalarSiren(4, 8, 2)
    x = points(5, 4).float()
    assert network(x).shape == (5,)
    jet = network.jet(x)
    assert jet.value.shape == (5,)
    assert jet.gradient.shape == (5, 4)


def test_vector_fields_differentiate_by_the_first_coordinates() -> None:
    network = VectorSiren(4, 3, 8, 2)
    jet = network.jet(points(5, 4).float(), directions=3)
    assert jet.value.shape == (5, 3)
    assert jet.jacobian.shape == (5, 3, 3)


def test_jets_carry_the_value_of_the_network_and_its_derivative() -> None:
    scalar, vector = ScalarSiren(4, 16, 3).double(), VectorSiren(4, 3, 16, 3, omega=10.0).double()
    x = points(7, 4).requires_grad_()
    torch.testing.assert_close(scalar.jet(x).value, scalar(x))
    torch.testing.assert_close(scalar.jet(x).gradient, torch.autograd.grad(scalar(x).sum(), x)[0])
    torch.testing.assert_close(vector.jet(x, 3).value, vector(x))
    rows = [torch.autograd.grad(vector(x)[:, i].sum(), x)[0][:, :3] for i in range(3)]
    torch.testing.assert_close(vector.jet(x, 3).jacobian, torch.stack(rows, dim=1))


@pytest.mark.parametrize("inputs", [2, 3, 4])
def test_weights_start_uniform_within_the_bounds_of_the_siren_paper(inputs: int) -> None:
    width, omegas = 256, [30.0, 10.0, 60.0]
    network = Siren(inputs, 3, width, 3, omega=omegas)
    deep = [(6 / width) ** 0.5 / omega for omega in (10.0, 60.0, 60.0)]
    for linear, bound in zip(network.linears, [1 / inputs, *deep], strict=True):
        weights = linear.weight.detach()
        assert weights.abs().max() <= bound
        assert weights.std().item() == pytest.approx(bound / 3**0.5, rel=0.1)
        assert abs(weights.mean().item()) < 0.1 * bound
        assert linear.bias.detach().abs().max() <= linear.in_features**-0.5


def test_activations_keep_their_spread_from_layer_to_layer() -> None:
    """Sines of widely spread arguments have variance ½ (theorem 1.8 of the paper's supplement), however deep."""
    network = Siren(3, 1, hidden_features=256, hidden_layers=6, omega=30.0).double()
    h = points(2000, 3)
    with torch.no_grad():
        for linear in network.linears[:-1]:
            h = torch.sin(30.0 * linear(h))
            assert h.std().item() == pytest.approx(0.5**0.5, rel=0.1)


def test_initialization_follows_the_seed() -> None:
    torch.manual_seed(3)
    first = Siren(3, 1, 8, 2).state_dict()
    torch.manual_seed(3)
    second = Siren(3, 1, 8, 2).state_dict()
    torch.testing.assert_close(first, second, rtol=0, atol=0)


@pytest.mark.parametrize("omega", [1.0, 16.0, [64.0, 8.0, 2.0]])
def test_layers_taken_over_come_back_bitwise_for_frequencies_that_are_powers_of_two(omega: float | list[float]) -> None:
    source, copy = ScalarSiren(3, 16, 3, omega=30.0), ScalarSiren(3, 16, 3, omega=omega)
    copy.load_layers(source.layers)
    torch.testing.assert_close(copy.layers, source.layers, rtol=0, atol=0)
    x = points(20, 3).float()
    torch.testing.assert_close(copy(x), source(x), rtol=0, atol=0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("omega", [30.0, 60.0, [60.0, 30.0, 15.0]])
def test_layers_taken_over_come_back_to_the_last_digit(omega: float | list[float], dtype: torch.dtype) -> None:
    source, copy = ScalarSiren(3, 16, 3, omega=1.0).to(dtype), ScalarSiren(3, 16, 3, omega=omega).to(dtype)
    copy.load_layers(source.layers)
    torch.testing.assert_close(copy.layers, source.layers, rtol=2 * torch.finfo(dtype).eps, atol=0)


@pytest.mark.parametrize("omega", [1.0, 10.0, 60.0, [60.0, 30.0, 15.0]])
def test_the_function_does_not_depend_on_the_frequency_its_weights_are_stored_at(omega: float | list[float]) -> None:
    source, copy = ScalarSiren(4, 16, 3, omega=30.0).double(), ScalarSiren(4, 16, 3, omega=omega).double()
    copy.load_layers(source.layers)
    x = points(50, 4)
    torch.testing.assert_close(copy.jet(x), source.jet(x), rtol=1e-11, atol=1e-11)


def test_taking_over_layers_records_no_gradient() -> None:
    source, copy = ScalarSiren(3, 8, 2), ScalarSiren(3, 8, 2)
    copy.load_layers(source.layers)
    assert all(p.requires_grad and p.grad_fn is None for p in copy.parameters())


def test_a_gradient_reaches_every_parameter() -> None:
    scalar, vector = ScalarSiren(4, 8, 3), VectorSiren(4, 3, 8, 3)
    x = points(10, 4).float()
    jets = (scalar.jet(x), vector.jet(x, 3))
    sum(part.square().sum() for jet in jets for part in jet).backward()
    for network in (scalar, vector):
        assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in network.parameters())
