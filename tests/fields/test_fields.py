"""Every β, velocity, and initialization of f in the configuration."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
from hydra.utils import instantiate
from runs import composed
from torch import Tensor
from torch.func import jacrev, vmap

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.fields import (
    AdaDiv,
    Beta,
    Free,
    Gaussian,
    LipschitzMlp,
    Nise,
    NullDiv,
    OfficialInit,
    OwnInit,
    Quadratic,
    Quartic,
    Rational,
    ScalarSiren,
    SirenInit,
    SourceInit,
    VectorSiren,
    Velocity,
)
from nsm.types import Jet

BETAS = sorted(p.stem for p in (CONF / "beta").glob("*.yaml"))
VELOCITIES = sorted(p.stem for p in (CONF / "velocity").glob("*.yaml") if p.stem != "none")
#: Those that have a network of their own.
LEARNED = [name for name in VELOCITIES if name != "nise"]
INITS = sorted(p.stem for p in (CONF / "init").glob("*.yaml"))
#: Each family with the name of its parameter.
FAMILIES = [(Gaussian, "alpha"), (Rational, "width"), (Quartic, "width"), (Quadratic, "width")]


def beta_of(name: str) -> Beta:
    return instantiate(composed(f"beta={name}").beta)


def velocity_of(name: str, dim: int) -> Velocity:
    small = [
        "network.velocity.hidden_features=8",
        "network.velocity.hidden_layers=2",
        "network.velocity.omega=2",
        "network.velocity.first_omega=2",
    ]
    velocity = instantiate(composed(f"velocity={name}", *small).velocity, dim=dim, _convert_="all").double()
    velocity.attach(field_of(dim), target_of(dim))
    return velocity


def target_of(dim: int) -> Callable[[Tensor], Tensor]:
    """A smooth function of space."""
    still = ScalarSiren(dim, 8, 2, omega=2.0).double()
    return lambda x: still(x)


def points(n: int, dim: int) -> Tensor:
    """Points (n, d + 1) of space-time."""
    return torch.rand(n, dim + 1, dtype=torch.float64) * 2 - 1


def field_of(dim: int) -> ScalarSiren:
    return ScalarSiren(dim + 1, 8, 2, omega=2.0).double()


def jet_of(field: Callable[[Tensor], Tensor], p: Tensor) -> Jet:
    """A jet by torch.func, so that it can be differentiated once more."""
    return Jet(field(p), vmap(jacrev(lambda q: field(q[None])[0]))(p))


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


@pytest.mark.parametrize("name", VELOCITIES)
@pytest.mark.parametrize("dim", [2, 3])
def test_velocities_are_vectors_and_their_divergence_a_scalar(name: str, dim: int) -> None:
    velocity, p = velocity_of(name, dim), points(5, dim)
    jet = field_of(dim).jet(p)
    assert velocity(p, jet).shape == (5, dim)
    assert velocity.divergence(p, jet).shape == (5,)


@pytest.mark.parametrize("name", LEARNED)
@pytest.mark.parametrize("dim", [2, 3])
def test_a_gradient_reaches_every_parameter_of_a_velocity(name: str, dim: int) -> None:
    velocity, p = velocity_of(name, dim), points(20, dim)
    value = velocity(p, Jet(torch.ones(20).double(), torch.ones(20, dim + 1).double()))
    value.square().sum().backward()
    # the last bias of a potential is a constant, which differentiation takes away
    lost = {"network.linears.2.bias"} if name != "free" else set()
    for key, parameter in velocity.named_parameters():
        if key not in lost:
            assert parameter.grad is not None, key
            rows = parameter.grad.reshape(len(parameter), -1).abs().sum(1)
            assert (rows > 0).all(), key


@pytest.mark.parametrize("name", LEARNED)
@pytest.mark.parametrize("dim", [2, 3])
def test_the_divergence_is_the_trace_of_the_jacobian_where_f_moves_with_the_point(name: str, dim: int) -> None:
    velocity, field, p = velocity_of(name, dim), field_of(dim), points(15, dim)
    if isinstance(velocity, AdaDiv):
        value = undetached(velocity, field)
    else:

        def value(q: Tensor) -> Tensor:
            jacobian = vmap(jacrev(lambda r: velocity.network(r[None])[0]))(q)[:, :, :dim]
            return velocity.network(q) if isinstance(velocity, Free) else skew(jacobian)

    torch.testing.assert_close(velocity(p, field.jet(p)), value(p))
    jacobian = vmap(jacrev(lambda q: value(q[None])[0]))(p)[:, :, :dim]
    expected = jacobian.diagonal(dim1=1, dim2=2).sum(1)
    torch.testing.assert_close(velocity.divergence(p, field.jet(p)), expected, atol=1e-10, rtol=1e-9)
    assert isinstance(velocity, NullDiv) or expected.abs().max() > 1e-5


def skew(jacobian: Tensor) -> Tensor:
    if jacobian.shape[2] == 2:
        return torch.stack([jacobian[:, 0, 1], -jacobian[:, 0, 0]], 1)
    d = jacobian.permute(1, 2, 0)
    return torch.stack([d[2, 1] - d[1, 2], d[0, 2] - d[2, 0], d[1, 0] - d[0, 1]], 1)


def undetached(velocity: AdaDiv, field: ScalarSiren) -> Callable[[Tensor], Tensor]:
    """V as a function of the point alone, f(x, t) inside β included."""

    def value(q: Tensor) -> Tensor:
        jacobian = vmap(jacrev(lambda r: velocity.network(r[None])[0]))(q)[:, :, : velocity.dim]
        return skew(jacobian[:, 1:]) + velocity.beta(field(q))[:, None] * jacobian[:, 0]

    return value


@pytest.mark.parametrize("dim", [2, 3])
def test_on_the_surface_adaptive_divergence_is_none(dim: int) -> None:
    velocity, p = velocity_of("adadiv", dim), points(15, dim)
    on = Jet(torch.zeros(15, dtype=torch.float64), torch.randn(15, dim + 1, dtype=torch.float64))
    jacobian = velocity.network.jet(p, dim).jacobian
    torch.testing.assert_close(velocity(p, on), skew(jacobian[:, 1:]), rtol=0, atol=1e-15)
    assert (velocity.divergence(p, on) == 0).all()


@pytest.mark.parametrize("name", LEARNED)
def test_a_learned_velocity_sends_no_gradient_into_f(name: str) -> None:
    velocity, field, p = velocity_of(name, 3), field_of(3), points(5, 3)
    jet = field.jet(p)
    (velocity(p, jet).sum() + velocity.divergence(p, jet).sum() + 0 * jet.value.sum()).backward()
    assert all(q.grad is None or (q.grad == 0).all() for q in field.parameters())


@pytest.mark.parametrize("dim", [2, 3])
def test_a_flow_without_divergence_keeps_volume(dim: int) -> None:
    """The volume element of the flow map, det ∂φ/∂x, stays 1 at every point of a ball."""
    velocity = velocity_of("nulldiv", dim)
    nothing = Jet(torch.zeros(1).double(), torch.zeros(1, dim + 1).double())

    def flow(x: Tensor, steps: int = 40) -> Tensor:
        def v(y: Tensor, t: float) -> Tensor:
            p = torch.cat([y, y.new_tensor([t])])[None]
            jacobian = vmap(jacrev(lambda r: velocity.network(r[None])[0]))(p)[:, :, :dim]
            return skew(jacobian)[0]

        h = 1 / steps
        for i in range(steps):
            t = i * h
            a = v(x, t)
            b = v(x + h / 2 * a, t + h / 2)
            c = v(x + h / 2 * b, t + h / 2)
            x = x + h / 6 * (a + 2 * b + 2 * c + v(x + h * c, t + h))
        return x

    ball = torch.randn(20, dim, dtype=torch.float64)
    ball = 0.5 * ball / ball.norm(dim=1, keepdim=True) * torch.rand(20, 1, dtype=torch.float64) ** (1 / dim)
    assert velocity(torch.cat([ball, 0 * ball[:, :1]], 1), nothing).norm(dim=1).max() > 0.05
    elements = torch.linalg.det(vmap(jacrev(flow))(ball))
    torch.testing.assert_close(elements, torch.ones_like(elements), rtol=0, atol=1e-7)


def test_a_flow_without_divergence_keeps_the_area_of_a_polygon() -> None:
    velocity = velocity_of("nulldiv", 2)
    angle = torch.linspace(0, 2 * math.pi, 401, dtype=torch.float64)[:-1]
    corners = start = 0.5 * torch.stack([angle.cos(), angle.sin()], 1)

    def v(x: Tensor, t: float) -> Tensor:
        p = torch.cat([x, torch.full_like(x[:, :1], t)], 1)
        with torch.no_grad():
            return velocity(p, Jet(p[:, 0], p))

    def area(x: Tensor) -> float:
        following = x.roll(-1, 0)
        return float((x[:, 0] * following[:, 1] - x[:, 1] * following[:, 0]).sum()) / 2

    for i in range(50):
        h, t = 0.02, 0.02 * i
        a = v(corners, t)
        b = v(corners + h / 2 * a, t + h / 2)
        c = v(corners + h / 2 * b, t + h / 2)
        corners = corners + h / 6 * (a + 2 * b + 2 * c + v(corners + h * c, t + h))
    assert (corners - start).norm(dim=1).max() > 0.05
    assert area(corners) == pytest.approx(area(start), rel=1e-4)


@pytest.mark.parametrize(("scale", "decay"), [(1.0, 0.0), (0.5, 1.0)])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_velocity_of_nise_is_its_formula_and_its_divergence_the_trace(dim: int, scale: float, decay: float) -> None:
    velocity, field, p = Nise(dim, scale, decay), field_of(dim), points(15, dim)
    goal = ScalarSiren(dim, 8, 2, omega=2.0).double()
    velocity.attach(field, goal)

    def value(q: Tensor) -> Tensor:
        gradient = vmap(jacrev(lambda r: field(r[None])[0]))(q)[:, :dim]
        remaining = goal(q[:, :dim]) - field(q)
        speed = scale * torch.exp(-decay * field(q) ** 2) * remaining
        return -speed[:, None] * gradient / gradient.norm(dim=1, keepdim=True)

    jet = field.jet(p)
    torch.testing.assert_close(velocity(p, jet), value(p))
    expected = vmap(jacrev(lambda q: value(q[None])[0]))(p)[:, :, :dim].diagonal(dim1=1, dim2=2).sum(1)
    assert expected.abs().max() > 1e-3
    torch.testing.assert_close(velocity.divergence(p, jet), expected, atol=1e-9, rtol=1e-8)


def test_nise_stops_where_f_is_the_target_and_moves_outwards_where_the_target_is_larger() -> None:
    x = torch.randn(20, 3, dtype=torch.float64)
    length = x.norm(dim=1)
    p, ball = torch.cat([x, x[:, :1]], 1), Jet(length - 0.5, torch.cat([x / length[:, None], x[:, :1] * 0], 1))
    velocity = Nise(3)
    velocity.attach(field_of(3), lambda y: y.norm(dim=1) - 0.5)
    assert velocity(p, ball).abs().max() < 1e-12
    velocity.attach(field_of(3), lambda y: y.norm(dim=1) - 0.7)
    torch.testing.assert_close(velocity(p, ball), 0.2 * x / length[:, None])


def test_nise_asks_for_f_and_the_target_before_it_is_evaluated() -> None:
    p = points(3, 2)
    with pytest.raises(ValueError, match=r"must know f and the target.*velocity.attach"):
        Nise(2)(p, field_of(2).jet(p))


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


def test_own_init_leaves_the_weights_alone() -> None:
    network = LipschitzMlp(4, 16, 3)
    before = {name: value.clone() for name, value in network.state_dict().items()}
    OwnInit()(network, None)
    torch.testing.assert_close(network.state_dict(), before, rtol=0, atol=0)


def test_source_init_is_the_source_at_every_time() -> None:
    field, source = ScalarSiren(4, 16, 3, omega=16.0), ScalarSiren(3, 16, 3, omega=32.0)
    SourceInit()(field, source)
    x = torch.rand(20, 3) * 2 - 1
    for t in (0.0, 0.3, 1.0):
        p = torch.cat([x, torch.full((20, 1), t)], 1)
        torch.testing.assert_close(field(p), source(x), rtol=1e-5, atol=1e-6)
        assert (field.jet(p).gradient[:, 3] == 0).all()


def test_official_init_is_the_source_read_at_a_lower_frequency() -> None:
    field, source = ScalarSiren(4, 16, 3, omega=30.0).double(), ScalarSiren(3, 16, 3, omega=60.0).double()
    OfficialInit(0.25)(field, source)
    slow = ScalarSiren(3, 16, 3, omega=15.0).double()
    slow.load_state_dict(source.state_dict())
    x = torch.rand(20, 3, dtype=torch.float64)
    torch.testing.assert_close(field(torch.cat([x, x[:, :1]], 1)), slow(x))


def test_siren_init_needs_no_source_and_changes_the_weights() -> None:
    field = ScalarSiren(4, 16, 3)
    before = field.linears[0].weight.clone()
    SirenInit()(field, None)
    assert not SirenInit.needs_source
    assert not torch.equal(field.linears[0].weight, before)


@pytest.mark.parametrize("init", [SourceInit(), OfficialInit()])
@pytest.mark.parametrize("source", [None, ScalarSiren(3, 8, 3), ScalarSiren(3, 16, 2)])
def test_f_starts_only_from_a_network_of_its_own_size(init: SourceInit, source: ScalarSiren | None) -> None:
    with pytest.raises(ValueError, match="same width and depth"):
        init(ScalarSiren(4, 16, 3), source)


@pytest.mark.parametrize("name", INITS)
def test_every_init_of_the_configuration_starts_f(name: str) -> None:
    init = instantiate(composed(f"init={name}").init)
    field = ScalarSiren(3, 8, 2)
    init(field, ScalarSiren(2, 8, 2) if init.needs_source else None)
    assert all(p.isfinite().all() for p in field.parameters())


@pytest.mark.parametrize("dim", [2, 3])
def test_only_the_unconstrained_velocity_has_second_derivatives(dim: int) -> None:
    p = points(3, dim)
    assert velocity_of("free", dim).jet_and_laplacian(p)[1].shape == (3, dim)
    for name in ("adadiv", "nulldiv", "nise"):
        with pytest.raises(InputError, match=r"must provide second derivatives.*Try `velocity=free`"):
            velocity_of(name, dim).jet_and_laplacian(p)


def test_the_divergence_of_nise_needs_a_hessian() -> None:
    velocity, field, p = Nise(2), LipschitzMlp(3, 8, 2).double(), points(3, 2)
    velocity.attach(field, target_of(2))
    with pytest.raises(InputError, match=r"got LipschitzMlp. Try `field=siren`"):
        velocity.divergence(p, field.jet(p))


def test_velocities_take_the_network_that_they_are_given() -> None:
    def network(in_features: int, out_features: int) -> VectorSiren:
        return VectorSiren(in_features, out_features, 8, 2)

    outputs = {(dim, made.network.out_features) for dim in (2, 3) for made in [AdaDiv(dim, network, Gaussian())]}
    assert outputs == {(2, 2), (3, 4)}
    assert NullDiv(3, network).network.out_features == 3
    assert Free(2, network).network.out_features == 2
