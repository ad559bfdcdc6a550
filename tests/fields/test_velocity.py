"""Every velocity of the configuration: values, divergence, gradients, and flows."""

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
    Free,
    Gaussian,
    LipschitzMlp,
    Nise,
    NullDiv,
    ScalarSiren,
    VectorSiren,
    Velocity,
)
from nsm.types import Jet, Key, SignedDistance

VELOCITIES = sorted(p.stem for p in (CONF / "velocity").glob("*.yaml") if p.stem != "none")
#: Those that have a network of their own.
LEARNED = [name for name in VELOCITIES if name != "nise"]


def between(target: SignedDistance) -> list[Key]:
    """Keys of a morph to a target from anywhere."""
    return [Key(0.0, lambda x: x.norm(dim=1) - 1), Key(1.0, target)]


def velocity_of(name: str, dim: int) -> Velocity:
    small = [
        "network.velocity.hidden_features=8",
        "network.velocity.hidden_layers=2",
        "network.velocity.omega=2",
        "network.velocity.first_omega=2",
    ]
    velocity = instantiate(composed(f"velocity={name}", *small).velocity, dim=dim, _convert_="all").double()
    velocity.attach(field_of(dim), between(target_of(dim)))
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
    velocity.attach(field, between(goal))

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
    velocity.attach(field_of(3), between(lambda y: y.norm(dim=1) - 0.5))
    assert velocity(p, ball).abs().max() < 1e-12
    velocity.attach(field_of(3), between(lambda y: y.norm(dim=1) - 0.7))
    torch.testing.assert_close(velocity(p, ball), 0.2 * x / length[:, None])


def test_nise_asks_for_f_and_the_target_before_it_is_evaluated() -> None:
    p = points(3, 2)
    with pytest.raises(ValueError, match=r"must know f and the target.*velocity.attach"):
        Nise(2)(p, field_of(2).jet(p))


@pytest.mark.parametrize("dim", [2, 3])
def test_only_the_unconstrained_velocity_has_second_derivatives(dim: int) -> None:
    p = points(3, dim)
    assert velocity_of("free", dim).jet_and_laplacian(p)[1].shape == (3, dim)
    for name in ("adadiv", "nulldiv", "nise"):
        with pytest.raises(InputError, match=r"must provide second derivatives.*Try `velocity=free`"):
            velocity_of(name, dim).jet_and_laplacian(p)


def test_the_divergence_of_nise_needs_a_hessian() -> None:
    velocity, field, p = Nise(2), LipschitzMlp(3, 8, 2).double(), points(3, 2)
    velocity.attach(field, between(target_of(2)))
    with pytest.raises(InputError, match=r"got LipschitzMlp. Try `field=siren`"):
        velocity.divergence(p, field.jet(p))


def test_velocities_take_the_network_that_they_are_given() -> None:
    def network(in_features: int, out_features: int) -> VectorSiren:
        return VectorSiren(in_features, out_features, 8, 2)

    outputs = {(dim, made.network.out_features) for dim in (2, 3) for made in [AdaDiv(dim, network, Gaussian())]}
    assert outputs == {(2, 2), (3, 4)}
    assert NullDiv(3, network).network.out_features == 3
    assert Free(2, network).network.out_features == 2
