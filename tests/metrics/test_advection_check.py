"""Advection of a surface by velocities that are known."""

from __future__ import annotations

import pytest
import torch
from measured import Still, advected
from problems import MOTIONS, Ball

from nsm.geometry.advection import advect
from nsm.geometry.meshing import extract_surface
from nsm.geometry.topology import enclosed_volume
from nsm.metrics.advection import check_advection
from nsm.types import SimplexMesh


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", ["squashed_ball", "squashed_box", "rotating_box", "translating_ball", "growing_ball"])
def test_a_carried_surface_keeps_to_f_and_a_free_one_not_to_its_volume(name, dim):
    motion, times = MOTIONS[name](dim), [0.0, 0.5, 1.0]
    check = advected(motion, times, 40)
    exact = [motion.volume(t) / motion.volume(0.0) for t in times]
    # a linear motion keeps the proportions of volumes of polyhedra exactly, a radial one to the order of their cells
    assert check.volumes == pytest.approx(exact, rel=6e-3 if name == "growing_ball" else 1e-6)
    # both surfaces are polyhedra, and cut edges by less than a cell
    cell = 2 / 40
    assert check.mean_distance < cell / 8
    assert check.maximum_distance < cell


def test_the_drift_of_a_flow_that_bends_a_surface_is_that_of_its_mesh_and_is_told():
    """A shear, x₂ += 0.3 sin(4 x₁) t, keeps all volumes; straight segments follow it where they are short."""
    middle = torch.tensor([0.1, 0.07], dtype=torch.double)

    class Sheared(Still):
        has_velocity = True

        def velocity(self, x, t):
            return torch.stack([0 * x[:, 0], 0.3 * torch.sin(4 * x[:, 0])], 1)

    def field(x, t):
        return Ball(2).jet(torch.stack([x[:, 0], x[:, 1] - 0.3 * t * torch.sin(4 * x[:, 0])], 1) - middle).value

    coarse, fine = (advected(Sheared(2, field), [0.0, 0.5, 1.0], resolution) for resolution in (24, 48))
    for check in (coarse, fine):
        assert check.drift < check.error
    assert coarse.mean_distance < 0.02
    assert fine.error < coarse.error < 1e-4


@pytest.mark.parametrize("dim", [2, 3])
def test_a_surface_that_a_flow_winds_up_keeps_its_volume(dim):
    """A swirl about the origin, by an angle of 6 exp(−8 r²) at t = 1, keeps all volumes and stretches edges."""

    class Swirling(Still):
        has_velocity = True

        def velocity(self, x, t):
            speed = 6 * torch.exp(-8 * x[:, :2].square().sum(1))
            return torch.cat([torch.stack([-speed * x[:, 1], speed * x[:, 0]], 1), 0 * x[:, 2:]], 1)

    middle = torch.tensor([0.3, 0.0, 0.0][:dim], dtype=torch.double)
    morph = Swirling(dim, lambda x, t: Ball(dim).jet(x - middle).value)
    check = advected(morph, [0.0, 0.5, 1.0], 20)
    assert check.drift < check.error < 3e-3
    rough = extract_surface(morph.source, morph.bounds, 20)
    wound = SimplexMesh(advect(morph.velocity, rough.vertices, [0.0, 1.0])[-1], rough.simplices)
    assert abs(enclosed_volume(wound) / enclosed_volume(rough) - 1) > 10 * check.drift


def test_without_velocity_or_surface_nothing_is_carried():
    morph = Still(2, lambda x, t: x.norm(dim=1) - 0.5)
    assert advected(morph, [0.0, 1.0], 16) is None
    gone = MOTIONS["growing_ball"](2)
    empty = extract_surface(lambda x: x[:, 0] ** 2 + 1, gone.bounds, 8)
    assert check_advection(gone, empty, [0.0], [empty]) is None
