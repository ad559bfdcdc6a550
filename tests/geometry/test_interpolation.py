"""Cubics on a lattice: what they reproduce, how fast they converge, and their gradient."""

from __future__ import annotations

import pytest
import torch
from problems import MOTIONS

from nsm.geometry.flow import FlowMaps
from nsm.geometry.grid import Lattice
from nsm.geometry.interpolation import Interpolant

BOX = torch.tensor([[-1.0, -0.5, 0.0], [1.0, 1.0, 0.8]], dtype=torch.float64)
both_dims = pytest.mark.parametrize("dim", [2, 3])


def sampled(function, dim, resolution):
    lattice = Lattice.corners(BOX[:, :dim], resolution)
    return Interpolant(lattice, function(lattice.points(lattice.indices())))


def inner(dim, count=200, margin=0.3):
    low, high = BOX[:, :dim] + margin * (BOX[1, :dim] - BOX[0, :dim]) * torch.tensor([[1.0], [-1.0]])
    return low + (high - low) * torch.rand(count, dim, dtype=torch.float64)


def wave(x):
    phase = 3 * x.cumsum(1)
    return torch.cat([phase.sin(), phase[:, :1].cos()], 1)


@both_dims
def test_values_on_the_lattice_and_quadratics_between_them_are_reproduced(dim):
    def quadratic(x):
        return torch.stack([x.square().sum(1) + x[:, 0] * x[:, 1] - 1, x.prod(1)], 1)

    known = sampled(quadratic, dim, 9)
    nodes = known.lattice.points(known.lattice.indices())
    assert torch.allclose(known(nodes), quadratic(nodes), atol=1e-12)
    x = inner(dim)
    assert torch.allclose(known(x), quadratic(x), atol=1e-12)
    assert torch.allclose(known.jet(x)[0], quadratic(x), atol=1e-12)


@both_dims
def test_linear_functions_are_reproduced_up_to_the_faces(dim):
    known = sampled(lambda x: x.cumsum(1) - 1, dim, 9)
    x = inner(dim, margin=0.0)
    assert torch.allclose(known(x), x.cumsum(1) - 1, atol=1e-12)


@both_dims
def test_the_error_falls_with_the_third_power_of_the_cells(dim):
    x = inner(dim)
    errors = [(sampled(wave, dim, n)(x) - wave(x)).abs().max() for n in (12, 24)]
    assert errors[1] < errors[0] / 7


@both_dims
def test_the_gradient_is_that_of_the_interpolant(dim):
    known = sampled(wave, dim, 10)
    x = inner(dim, margin=-0.1)
    _, gradient = known.jet(x)
    for axis, step in enumerate(1e-6 * torch.eye(dim, dtype=torch.float64)):
        difference = (known(x + step) - known(x - step)) / 2e-6
        assert torch.allclose(gradient[:, :, axis], difference, atol=1e-6)


@both_dims
def test_beyond_the_lattice_nothing_changes(dim):
    known = sampled(wave, dim, 10)
    corner = BOX[1:, :dim]
    assert torch.equal(known(corner + 0.5), known(corner))
    assert not known.jet(corner + 0.5)[1].any()


def test_values_that_do_not_fit_the_lattice():
    with pytest.raises(ValueError, match="`values` must have one row for each of 9 points, got 8 rows"):
        Interpolant(Lattice.corners(BOX[:, :2], 2)._replace(shape=(3, 3)), torch.zeros(8, 1, dtype=torch.float64))


@both_dims
@pytest.mark.parametrize("name", ["rotating_box", "squashed_ball", "growing_ball"])
def test_flow_maps_are_the_flow(name, dim):
    motion = MOTIONS[name](dim)
    # within the box on their way, and away from the origin, where the velocity of growing_ball is not smooth
    x = torch.nn.functional.normalize(torch.randn(100, dim, dtype=torch.float64), dim=1) * 0.4
    errors = []
    for resolution in {2: (15, 31), 3: (9, 19)}[dim]:
        maps = FlowMaps(motion.velocity, motion.bounds, resolution, 5)
        for t in (0.0, 0.3, 1.0)[dim - 2 :]:
            back, on = (x + part for part in maps.at(t)(x).split(dim, 1))
            assert t != 0.0 or torch.equal(back, x)
            assert t != 1.0 or torch.equal(on, x)
            # f is carried exactly, so it is the same at both places
            errors.append(
                max((motion(y, end) - motion(x, t)).abs().max().item() for y, end in ((back, 0.0), (on, 1.0)))
            )
    assert max(errors[len(errors) // 2 :]) < 6e-3
    assert name == "growing_ball" or max(errors[len(errors) // 2 :]) < 1e-5
    assert (
        max(errors[len(errors) // 2 :]) < max(errors[: len(errors) // 2]) / 2 or max(errors[: len(errors) // 2]) < 1e-5
    )


def test_flow_maps_are_made_once_for_a_time_and_few_are_kept():
    motion = MOTIONS["squashed_ball"](2)
    calls = []

    def velocity(x, t):
        calls.append(t)
        return motion.velocity(x, t)

    maps = FlowMaps(velocity, motion.bounds, 4, 3, steps=1)
    assert len(calls) == 3
    assert maps.at(0.5) is maps.at(0.5)
    for t in torch.linspace(0, 1, 40).tolist():
        maps.at(t)
    assert len(calls) == 3
    assert len(maps._cache) == 32


@both_dims
def test_no_points_have_no_values(dim):
    known, nothing = sampled(wave, dim, 9), torch.zeros(0, dim, dtype=torch.float64)
    assert known(nothing).shape == (0, dim + 1)
    assert [part.shape for part in known.jet(nothing)] == [(0, dim + 1), (0, dim + 1, dim)]
