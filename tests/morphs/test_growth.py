"""Changing volumes: the schedules, and the identities that a grown morph keeps."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest
import torch
from analytic import shrinking
from problems import MOTIONS, Ball, GrowingBall, LinearMotion

from nsm.geometry.meshing import extract_surface, open_sides
from nsm.geometry.volume import volume
from nsm.morphs.growth import Grown, ScaleLinear, SmoothStep, Table, VolumeLinear
from nsm.morphs.surfaces import initial_volume
from nsm.shapes import SirenFile, equal_volume, primitive
from nsm.types import Morph

GROWTHS = {
    "volume_linear": lambda dim: VolumeLinear(dim, 1.5, 0.5),
    "scale_linear": lambda dim: ScaleLinear(dim, 0.5, 1.5),
    "smooth_step": lambda dim: SmoothStep(dim, 1.0, 1.5),
    "table": lambda dim: Table(dim, [0, 0.3, 1], [1.0, 1.4, 0.8]),
}
TIMES = torch.linspace(0, 1, 101, dtype=torch.float64)
both_dims = pytest.mark.parametrize("dim", [2, 3])
each_growth = pytest.mark.parametrize("name", GROWTHS)


@both_dims
def test_each_schedule_is_what_it_is_called(dim):
    half = 0.5
    assert VolumeLinear(dim, 1, 3).relative_volume(half) == pytest.approx(2)
    assert ScaleLinear(dim, 1, 2**dim).scale(half) == pytest.approx(1.5)
    assert SmoothStep(dim, 1, 3).relative_volume(half) == pytest.approx(2)
    assert [SmoothStep(dim, 1, 3).rate(t) for t in (0.0, 1.0)] == [0, 0]
    assert SmoothStep(dim, 1, 3).relative_volume(0.25) == pytest.approx(1 + 2 * (3 / 16 - 2 / 64))


@both_dims
@each_growth
def test_rates_are_derivatives_and_scales_are_roots(name, dim):
    growth = GROWTHS[name](dim)
    t = TIMES.clone().requires_grad_()
    for function, derivative in ((growth.scale, growth.rate), (growth.relative_volume, growth.relative_rate)):
        (slope,) = torch.autograd.grad(function(t).sum(), t)
        assert derivative(TIMES) == pytest.approx(slope.detach(), abs=1e-12)
        single = [function(float(time)) for time in TIMES]
        assert all(isinstance(value, float) for value in single)
        assert function(TIMES) == pytest.approx(torch.tensor(single, dtype=torch.double))
    assert growth.scale(TIMES) ** dim == pytest.approx(growth.relative_volume(TIMES))


@each_growth
def test_extremes_hold_over_time(name):
    growth = GROWTHS[name](3)
    volumes = growth.relative_volume(TIMES)
    assert growth.extremes == pytest.approx((float(volumes.min()), float(volumes.max())), rel=1e-3)


def test_a_table_is_smooth_and_does_not_overshoot():
    table = Table(3, [0, 0.2, 0.5, 1], [1.0, 2.0, 2.0, 0.5])
    volumes = table.relative_volume(TIMES)
    assert (volumes.diff()[:20] > 0).all()
    assert volumes[20:51] == pytest.approx(torch.full((31,), 2.0, dtype=torch.double))
    assert (volumes.diff()[50:] < 0).all()
    assert table.relative_rate(TIMES).diff().abs().max() < 0.2 * table.relative_rate(TIMES).abs().max()


@both_dims
@each_growth
@pytest.mark.parametrize("motion", MOTIONS)
def test_a_grown_motion_moves_as_its_velocity_says(motion, name, dim):
    """∂f̃/∂t + ⟨∇f̃, Ṽ⟩ = (α'/α) f̃, by finite differences in space and time; div Ṽ likewise."""
    grown = Grown(MOTIONS[motion](dim), GROWTHS[name](dim))
    assert isinstance(grown, Morph)
    generator, step = torch.Generator().manual_seed(0), 1e-5
    t = torch.rand(400, generator=generator, dtype=torch.double) * 0.25 + 0.01  # between the knots of the table
    inside = grown.growth.scale(t)[:, None] * 0.99
    x = (torch.rand(400, dim, generator=generator, dtype=torch.double) * 2 - 1) * inside
    offsets = step * torch.eye(dim, dtype=torch.double)
    gradient = torch.stack([(grown(x + e, t) - grown(x - e, t)) / (2 * step) for e in offsets], 1)
    smooth = (gradient - grown.gradient(x, t)).norm(dim=1) < 1e-4  # away from the creases of boxes
    assert smooth.double().mean() > 0.97
    rate = (grown(x, t + step) - grown(x, t - step)) / (2 * step)
    source = (grown.growth.rate(t) / grown.growth.scale(t)) * grown(x, t)
    residual = rate + (grown.gradient(x, t) * grown.velocity(x, t)).sum(1) - source
    assert residual[smooth].abs().max() < 1e-6
    moved = [(grown.velocity(x + e, t) - grown.velocity(x - e, t)) / (2 * step) for e in offsets]
    divergence = sum(along[:, i] for i, along in enumerate(moved))
    assert grown.divergence(x, t)[smooth] == pytest.approx(divergence[smooth], abs=1e-4)


@both_dims
@each_growth
def test_volumes_follow_the_schedule(name, dim):
    motion = GrowingBall(dim, 0.4, 0.2)
    grown = Grown(motion, GROWTHS[name](dim))
    for t in (0.0, 0.4, 1.0):
        relative = grown.growth.relative_volume(t)
        assert volume(partial(grown, t=t), grown.bounds, 40) == pytest.approx(motion.volume(t) * relative, rel=1e-3)
        start = motion.volume(0) * grown.growth.relative_volume(0.0)
        assert initial_volume(grown) == pytest.approx(start, rel=1e-5)
        assert grown.wanted_volume(t, start) == pytest.approx(motion.volume(0) * relative)


@both_dims
def test_a_still_ball_that_grows_is_a_growing_ball(dim):
    still = LinearMotion(Ball(dim, 0.4))
    grown = Grown(still, ScaleLinear(dim, 1.0, (7 / 4) ** dim))
    exact = GrowingBall(dim, 0.4, 0.3)
    x = torch.rand(200, dim, dtype=torch.double) - 0.5
    t = torch.rand(200, dtype=torch.double)
    assert grown(x, t) == pytest.approx(exact(x, t[:]), abs=1e-12)
    normal = exact.gradient(x, t)
    assert grown.gradient(x, t) == pytest.approx(normal, abs=1e-12)
    on_surface = normal * (0.4 + 0.3 * t)[:, None]
    assert grown.velocity(on_surface, t) == pytest.approx(exact.velocity(on_surface, t), abs=1e-12)


class _Junk(GrowingBall):
    """A ball that fills its box, known in the box only: beyond it, as networks may, f is anything."""

    def __init__(self, dim: int) -> None:
        super().__init__(dim, 0.95, 0.0)

    def __call__(self, x, t):
        return torch.where((x.abs() <= 1).all(1), super().__call__(x, t), -1.0)


@both_dims
def test_the_box_grows_with_the_shape_and_nothing_from_beyond_it_shows(dim):
    grown = Grown(_Junk(dim), VolumeLinear(dim, 1.0, 2.0))
    factor = 2 ** (1 / dim)
    assert grown.bounds == pytest.approx(factor * grown.morph.bounds)
    for t in (0.0, 0.5, 1.0):
        field = partial(grown, t=t)
        mesh = extract_surface(field, grown.bounds, 40)
        radius = torch.full((len(mesh.vertices),), 0.95 * grown.growth.scale(t), dtype=torch.double)
        assert mesh.vertices.norm(dim=1) == pytest.approx(radius, abs=5e-3)
        assert open_sides(mesh, grown.domain(t)) == []
    x = (torch.rand(300, dim, dtype=torch.double) * 2 - 1) * factor
    outside = x[x.abs().amax(1) > 1]
    assert (grown(outside, 0.0) > 0).all()
    apart = (outside[:, None] - outside).norm(dim=2)
    assert ((grown(outside, 0.0)[:, None] - grown(outside, 0.0)).abs() <= 2**0.5 * apart + 1e-9).all()


def test_a_box_off_the_origin_holds_all_scales():
    still = LinearMotion(Ball(2, 0.2), start=[1.0, 0.0])
    still.bounds = torch.tensor([[0.5, -0.5], [1.5, 0.5]], dtype=torch.double)
    grown = Grown(still, ScaleLinear(2, 1.0, 4.0))
    assert grown.bounds.tolist() == [[0.5, -1.0], [3.0, 1.0]]


@both_dims
def test_the_ends_grow_too(dim):
    morph = shrinking(dim, 0.1)
    grown = Grown(morph, VolumeLinear(dim, 0.5, 2.0))
    for shape, own, t in ((grown.source, morph.source, 0.0), (grown.target, morph.target, 1.0)):
        scale = grown.growth.scale(t)
        assert shape.similarity.scale == pytest.approx(own.similarity.scale * scale)
        x = torch.rand(50, dim) - 0.5
        assert shape(x * scale) == pytest.approx(scale * own(x), abs=1e-5)
    assert grown.velocity(torch.zeros(3, dim), 0.5) is None
    assert grown.divergence(torch.zeros(3, dim), 0.5) is None


class _Blend(Morph):
    """A morph of any two shapes: the mean of their fields, of near constant volume where they are alike."""

    def __init__(self, source, target) -> None:
        self.dim, self.source, self.target = source.dim, source, target
        self.bounds, self.provenance = torch.tensor([[-1.0] * 3, [1.0] * 3]), {}

    def __call__(self, x, t):
        return (1 - t) * self.source(x) + t * self.target(x)

    def gradient(self, x, t):
        return (1 - t) * self.source.jet(x).gradient + t * self.target.jet(x).gradient


@torch.no_grad()
def test_an_end_shape_may_outgrow_the_box():
    morph = _Blend(primitive.Ball(0.8), primitive.Ball(0.6, center=[0.2, 0, 0], pose={"translation": [0.1, 0, 0]}))
    grown = Grown(morph, VolumeLinear(3, 1.0, 8.0))
    x = 4 * torch.rand(500, 3) - 2
    assert grown.bounds[1].tolist() == [2, 2, 2]
    assert grown.target(x) == pytest.approx((x - torch.tensor([0.6, 0, 0])).norm(dim=1) - 1.2, abs=1e-5)
    assert grown.target.surface().vertices.amax() == pytest.approx(1.8, abs=1e-3)


@torch.no_grad()
def test_official_shapes_of_different_volume_have_it_back_at_the_ends(data_dir: Path):
    small, large = SirenFile("official/ni/horse.pth"), SirenFile("official/ni/kitten.pth")
    ends = equal_volume(small, large)
    relative = [scale**-3 for scale in ends.scales]
    assert relative == [1.0, pytest.approx(2.9, rel=0.02)]
    grown = Grown(_Blend(*ends.shapes), VolumeLinear(3, own={0.0: relative[0], 1.0: relative[1]}))
    assert grown.bounds[1] == pytest.approx(torch.full((3,), 1 / ends.scales[1]))
    x = torch.rand(2000, 3) * 2 - 1
    # the larger one was scaled about its own center, and grows about that of the box
    away = large.bounds().mean(0) * (1 - 1 / ends.scales[1])
    for t, shape, y, end in ((0.0, small, x, grown.source), (1.0, large, x + away, grown.target)):
        assert grown(x, t) == pytest.approx(shape(y), abs=2e-5)
        assert end(x) == pytest.approx(shape(y), abs=2e-5)
        assert grown.gradient(x, t) == pytest.approx(shape.jet(y).gradient, abs=1e-3)
    assert volume(partial(grown, t=1.0), grown.bounds, 40) == pytest.approx(ends.volume * relative[1], rel=5e-3)
