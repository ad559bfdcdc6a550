"""Advection of a surface by velocities that are known."""

from __future__ import annotations

import math

import pytest
import torch
from measured import Still, advected
from problems import MOTIONS, Ball

from nsm.geometry.meshing import extract_surface
from nsm.metrics.advection import check_advection


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", ["squashed_ball", "squashed_box", "rotating_box", "translating_ball", "growing_ball"])
def test_a_carried_surface_keeps_to_f_and_a_free_one_not_to_its_volume(name, dim):
    motion, times = MOTIONS[name](dim), [0.0, 0.5, 1.0]
    check = advected(motion, times, 40)
    exact = [motion.volume(t) / motion.volume(0.0) for t in times]
    # det Dφ is the same everywhere for a linear motion, and not for a radial one
    assert check.volumes == pytest.approx(exact, rel=6e-3 if name == "growing_ball" else 1e-6)
    # both surfaces are polyhedra, and cut edges by less than a cell
    cell = 2 / 40
    assert check.mean_distance < cell / 8
    assert check.maximum_distance < cell


@pytest.mark.parametrize("dim", [2, 3])
def test_a_flow_that_expands_the_inside_and_keeps_the_surface_keeps_the_volume(dim):
    """V = f² x moves points inside of a ball outward, never across its surface, where V and its divergence vanish."""

    class Crowded(Still):
        has_velocity = True

        def velocity(self, x, t):
            return 2 * self.field(x, t).square()[:, None] * x

    check = advected(Crowded(dim, lambda x, t: Ball(dim).jet(x).value), [0.0, 0.5, 1.0], 24)
    assert check.drift < 3e-3
    assert check.error < 3e-3
    assert check.maximum_distance < 1e-2


@pytest.mark.parametrize("dim", [2, 3])
def test_a_surface_that_a_flow_winds_up_keeps_its_volume(dim):
    """A swirl about the origin, by an angle of 6 exp(−8 r²) at t = 1, keeps all volumes and stretches the surface."""

    class Swirling(Still):
        has_velocity = True

        def velocity(self, x, t):
            speed = 6 * torch.exp(-8 * x[:, :2].square().sum(1))
            return torch.cat([torch.stack([-speed * x[:, 1], speed * x[:, 0]], 1), 0 * x[:, 2:]], 1)

    middle = torch.tensor([0.3, 0.0, 0.0][:dim], dtype=torch.double)
    check = advected(Swirling(dim, lambda x, t: Ball(dim).jet(x - middle).value), [0.0, 0.5, 1.0], 20)
    assert check.drift < 1e-6
    assert check.error < 1e-6


def test_a_flow_that_shrinks_loses_the_volume_that_its_divergence_says():
    """V = −x/2 multiplies all volumes by exp(−d t / 2)."""

    class Shrinking(Still):
        has_velocity = True

        def velocity(self, x, t):
            return -x / 2

    check = advected(Shrinking(3, lambda x, t: Ball(3).jet(x).value), [0.0, 0.5, 1.0], 16)
    assert check.volumes == pytest.approx([math.exp(-1.5 * t) for t in (0.0, 0.5, 1.0)], rel=1e-6)


def test_without_velocity_or_surface_nothing_is_carried():
    morph = Still(2, lambda x, t: x.norm(dim=1) - 0.5)
    assert advected(morph, [0.0, 1.0], 16) is None
    gone = MOTIONS["growing_ball"](2)
    empty = extract_surface(lambda x: x[:, 0] ** 2 + 1, gone.bounds, 8)
    assert check_advection(gone, empty, [0.0], [empty], 8) is None
