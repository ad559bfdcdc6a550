"""Optimal transport against closed forms: maps between clouds, and the density of moving points."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.grid import Lattice
from nsm.morphs.optimal_transport import entropic
from nsm.morphs.optimal_transport.density import (
    REACH,
    distance_of_density,
    histogram,
    kernel_density,
    padded_lattice,
    points_inside,
)
from nsm.morphs.optimal_transport.entropic import entropic_maps
from nsm.shapes import Ball


def normal_points(count: int, deviations: list[float], seed: int) -> Tensor:
    """Evenly spread points of a Gaussian."""
    sequence = torch.quasirandom.SobolEngine(len(deviations), scramble=True, seed=seed)
    return torch.special.ndtri(sequence.draw(count).clamp(1e-4, 1 - 1e-4)) * torch.tensor(deviations)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_map_between_two_places_of_a_cloud_is_the_translation(dim: int) -> None:
    shift = torch.tensor([0.7, -0.3, 0.4])[:dim]
    x = points_inside(Ball(0.4, [0.0] * dim), 400, seed=3)
    forth, back = entropic_maps(x, x + shift, blur=0.05, scaling=0.9)
    elsewhere = points_inside(Ball(0.4, [0.0] * dim), 200, seed=4)
    torch.testing.assert_close(forth(elsewhere), elsewhere + shift, atol=4e-3, rtol=0)
    torch.testing.assert_close(back(elsewhere + shift), elsewhere, atol=4e-3, rtol=0)


def test_the_map_between_gaussians_is_linear_with_the_ratio_of_their_deviations() -> None:
    narrow, wide = [0.2, 0.3], [0.4, 0.15]
    x, y = normal_points(800, narrow, 0), normal_points(800, wide, 1)
    forth, back = entropic_maps(x, y, blur=0.05, scaling=0.8)
    matrix = torch.tensor(wide) / torch.tensor(narrow)
    inner = normal_points(300, narrow, 2)
    inner = inner[(inner / torch.tensor(narrow)).norm(dim=1) < 2]
    error = (forth(inner) - inner * matrix).norm(dim=1)
    assert error.mean() < 0.02 * max(wide)
    assert (back(inner * matrix) - inner).norm(dim=1).mean() < 0.04 * max(wide)
    # displacement interpolation: the linear map (1 − t) I + t A, a Gaussian at every time
    for t in (0.25, 0.5, 0.75):
        between = (1 - t) * x + t * forth(x)
        expected = (1 - t) * torch.tensor(narrow) + t * torch.tensor(wide)
        torch.testing.assert_close(between.std(0), expected, atol=0, rtol=0.02)


def test_the_plain_projection_draws_inwards_and_the_difference_does_not() -> None:
    x = points_inside(Ball(0.4, [0.0, 0.0]), 600, seed=0)
    y = points_inside(Ball(0.4, [0.0, 0.0]), 600, seed=1) + torch.tensor([0.5, 0.0])
    forth, _ = entropic_maps(x, y, blur=0.1, scaling=0.8)
    angle = torch.linspace(0, 2 * math.pi, 50)
    rim = 0.38 * torch.stack([angle.cos(), angle.sin()], 1)
    radius = [(image - torch.tensor([0.5, 0.0])).norm(dim=1).mean() for image in (forth.towards(rim), forth(rim))]
    assert radius[0] < 0.36
    assert radius[1] == pytest.approx(0.38, abs=0.004)


def test_a_map_in_chunks_is_the_map_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = (points_inside(Ball(0.3, [0.0, 0.0, 0.0]), 50, seed) for seed in (0, 1))
    forth, _ = entropic_maps(x, y, blur=0.1, scaling=0.5)
    z = torch.rand(37, 3) - 0.5
    whole = forth(z)
    monkeypatch.setattr(entropic, "_ENTRIES", 400)
    torch.testing.assert_close(forth(z), whole, atol=1e-5, rtol=0)


@pytest.mark.parametrize("dim", [2, 3])
def test_points_are_inside_fill_the_shape_evenly_and_follow_the_seed(dim: int) -> None:
    ball = Ball(0.4, [0.3, -0.2, 0.1][:dim])
    points = points_inside(ball, 4000, seed=5)
    assert (ball(points) < 0).all()
    for part in (points, points[:500]):  # anchors are a first part
        torch.testing.assert_close(part.mean(0), torch.tensor([0.3, -0.2, 0.1][:dim]), atol=0.012, rtol=0)
        within_half = ((part - torch.tensor([0.3, -0.2, 0.1][:dim])).norm(dim=1) < 0.2).float().mean()
        assert within_half == pytest.approx(0.5**dim, abs=0.02)
    assert torch.equal(points, points_inside(ball, 4000, seed=5))
    assert not torch.equal(points, points_inside(ball, 4000, seed=6))


def test_a_histogram_keeps_mass_and_its_middle_wherever_points_are() -> None:
    lattice = Lattice(torch.tensor([-1.0, -1.0, -0.5]), torch.tensor([0.1, 0.2, 0.25]), (21, 11, 5))
    points = (torch.rand(500, 3) * 2 - 1) * torch.tensor([1.0, 1.0, 0.5])
    masses = torch.rand(500)
    mass = histogram(points, masses, lattice)
    assert float(mass.sum()) == pytest.approx(float(masses.sum()), rel=1e-5)
    where = torch.stack(torch.meshgrid(*(torch.arange(n) for n in lattice.shape), indexing="ij"), -1)
    middle = (lattice.points(where) * mass[..., None]).sum((0, 1, 2)) / mass.sum()
    torch.testing.assert_close(middle, (points * masses[:, None]).sum(0) / masses.sum(), atol=1e-5, rtol=0)
    assert float(histogram(points * 9, masses, lattice).sum()) == pytest.approx(float(masses.sum()), rel=1e-5)


def test_one_point_becomes_a_gaussian_of_the_kernels_width() -> None:
    kernel = 0.1
    lattice = padded_lattice(torch.tensor([[-1.0, -1.0], [1.0, 1.0]]), 64, kernel)
    density = kernel_density(histogram(torch.tensor([[0.013, -0.207]]), torch.ones(1), lattice), lattice, kernel)
    where = lattice.points(torch.stack(torch.meshgrid(*(torch.arange(n) for n in lattice.shape), indexing="ij"), -1))
    expected = (-(where - torch.tensor([0.013, -0.207])).square().sum(-1) / (2 * kernel**2)).exp()
    torch.testing.assert_close(density, expected / (2 * math.pi * kernel**2), atol=0.25, rtol=0)  # of a peak of 16
    assert float(density.sum() * lattice.step.prod()) == pytest.approx(1, abs=2e-4)


def test_the_density_of_a_half_space_tells_the_distance_from_its_surface() -> None:
    kernel, s = 0.05, torch.linspace(-0.14, 0.14, 29, dtype=torch.double)
    density = torch.erfc(s / (kernel * math.sqrt(2))) / 2
    torch.testing.assert_close(distance_of_density(density, kernel), s)
    far = distance_of_density(torch.tensor([0.0, 1.0, 7.0], dtype=torch.double), kernel)
    torch.testing.assert_close(far, torch.tensor([REACH, -REACH, -REACH], dtype=torch.double) * kernel)


def test_a_shape_without_an_inside_is_refused() -> None:
    class Empty(Ball):
        def forward(self, x: Tensor) -> Tensor:
            return super().forward(x).abs() + 1

    with pytest.raises(InputError, match="must have an inside to be filled"):
        points_inside(Empty(0.3, [0.0, 0.0]), 10, seed=0)
