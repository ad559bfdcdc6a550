"""Every β of the configuration: its conditions at the surface, its derivative, and its parameter."""

from __future__ import annotations

import math

import pytest
import torch
from hydra.utils import instantiate
from runs import composed

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.fields import (
    Beta,
    Gaussian,
    Quadratic,
    Quartic,
    Rational,
)

BETAS = sorted(p.stem for p in (CONF / "beta").glob("*.yaml"))


#: Each family with the name of its parameter.
FAMILIES = [(Gaussian, "alpha"), (Rational, "width"), (Quartic, "width"), (Quadratic, "width")]


def beta_of(name: str) -> Beta:
    return instantiate(composed(f"beta={name}").beta)


@pytest.mark.parametrize("name", BETAS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_beta_and_its_derivative_vanish_exactly_on_the_surface(name: str, dtype: torch.dtype) -> None:
    beta, zero = beta_of(name), torch.zeros(1, dtype=dtype)
    assert beta(zero).item() == 0
    assert beta.derivative(zero).item() == 0


@pytest.mark.parametrize("name", BETAS)
def test_beta_is_even_and_never_negative_and_positive_elsewhere(name: str) -> None:
    beta, s = beta_of(name), torch.linspace(0.01, 3, 100, dtype=torch.float64)
    assert (beta(s) > 0).all()
    torch.testing.assert_close(beta(-s), beta(s), rtol=0, atol=0)
    torch.testing.assert_close(beta.derivative(-s), -beta.derivative(s), rtol=0, atol=0)


@pytest.mark.parametrize("name", BETAS)
def test_the_derivative_of_beta_is_its_derivative(name: str) -> None:
    beta, s = beta_of(name), torch.linspace(-3, 3, 101, dtype=torch.float64, requires_grad=True)
    torch.testing.assert_close(beta.derivative(s), torch.autograd.grad(beta(s).sum(), s)[0])


@pytest.mark.parametrize(("family", "parameter"), FAMILIES)
def test_every_beta_has_a_parameter_that_matters(family: type[Beta], parameter: str) -> None:
    s = torch.linspace(0.1, 2, 20, dtype=torch.float64)
    one, two = family(**{parameter: 0.5}), family(**{parameter: 1.0})
    assert ((one(s) - two(s)).abs() > 1e-3).all()


@pytest.mark.parametrize(("family", "parameter"), FAMILIES)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_every_beta_needs_a_positive_finite_parameter(family: type[Beta], parameter: str, value: float) -> None:
    with pytest.raises(InputError, match=f"beta.{parameter}.*{value}"):
        family(**{parameter: value})


def test_the_gaussian_is_the_papers() -> None:
    s = torch.tensor([0.3, -2.0], dtype=torch.float64)
    torch.testing.assert_close(Gaussian()(s), 1 - torch.exp(-0.1 * s**2))


@pytest.mark.parametrize(("family", "value"), [(Rational, 0.5), (Quartic, 0.5), (Quadratic, 1.0)])
def test_the_width_is_where_beta_takes_the_documented_value(family: type[Beta], value: float) -> None:
    assert family(width=0.7)(torch.tensor(0.7)).item() == pytest.approx(value)


def test_the_quadratic_and_the_gaussian_agree_near_the_surface() -> None:
    s = torch.tensor([1e-3], dtype=torch.float64)
    torch.testing.assert_close(Quadratic()(s), Gaussian()(s), rtol=1e-6, atol=0)
