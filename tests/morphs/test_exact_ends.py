"""Exact ends: on motions that are known exactly, of which f misses something at both ends."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from analytic import shrinking
from problems import LinearMotion, rotating_box, squashed_ball

from nsm import ExactEnds
from nsm.cli.errors import InputError
from nsm.geometry.advection import RungeKutta
from nsm.geometry.meshing import extract_surface
from nsm.geometry.topology import enclosed_volume
from nsm.geometry.volume import volume
from nsm.metrics.residuals import rate
from nsm.morphs.advected import advect_surface
from nsm.morphs.growth import Grown, VolumeLinear
from nsm.morphs.surfaces import ExactVolume, extract_frame
from nsm.types import Morph

both_dims = pytest.mark.parametrize("dim", [2, 3])
TIMES = (0.01, 0.2, 0.5, 0.93)


class Missing(Morph):
    """A motion whose f lacks bumps, which the flow advects from both ends: f = exact − cos² b₀(φ) − sin² b₁(φ)."""

    def __init__(self, motion: LinearMotion) -> None:
        self.motion, self.dim = motion, motion.dim
        self.bounds, self.source, self.target = motion.bounds, motion.source, motion.target
        self.provenance = motion.provenance

    def missing(self, x, t):
        t = torch.as_tensor(t).to(x)
        back = self.motion._back(x, t)[0]
        end = back @ torch.matrix_exp(self.motion.matrix).T
        bumps = (4 * back).sin().prod(1), (5 * end).cos().prod(1)
        return 0.01 * ((torch.pi / 2 * t).cos() ** 2 * bumps[0] + (torch.pi / 2 * t).sin() ** 2 * bumps[1])

    def __call__(self, x, t):
        return self.motion(x, t) - self.missing(x, t)

    def gradient(self, x, t):
        with torch.enable_grad():
            y = x.detach().requires_grad_()
            (slope,) = torch.autograd.grad(self.missing(y, t).sum(), y)
        return self.motion.gradient(x, t) - slope

    has_velocity = True

    def velocity(self, x, t):
        return self.motion.velocity(x, t)

    def divergence(self, x, t):
        return self.motion.divergence(x, t)


def repaired(dim, motion=squashed_ball, flow=12, detail=None):
    return ExactEnds(Missing(motion(dim)), flow, detail or {2: 256, 3: 64}[dim])


def near_surface(morph, t, count=400, width=0.008):
    """Points where the exact f is small."""
    motion = morph.morph.motion
    mesh = extract_surface(partial(motion, t=t), motion.bounds, 24)
    x = mesh.vertices[torch.randint(len(mesh.vertices), (count,))]
    return x + width * (2 * torch.rand(count, morph.dim, dtype=x.dtype) - 1)


@both_dims
def test_the_ends_are_the_shapes_themselves(dim):
    morph = repaired(dim)
    x = 2 * torch.rand(100, dim, dtype=torch.float64) - 1
    assert torch.equal(morph(x, 0.0), morph.source(x))
    assert torch.equal(morph(x, 1), morph.target(x))
    for t, shape in ((0.0, morph.source), (1.0, morph.target)):
        assert torch.equal(morph(x, torch.full((100,), t)), shape(x))
        y = near_surface(morph, t)
        assert torch.allclose(morph.gradient(y, t), morph.morph.motion.gradient(y, t), atol=1e-5)
    assert not torch.allclose(morph.morph(x, 0.0), morph.source(x), atol=1e-3)


@both_dims
@pytest.mark.parametrize("motion", [squashed_ball, rotating_box])
def test_what_was_missing_is_there_at_all_times(motion, dim):
    morph = repaired(dim, motion)
    for t in TIMES:
        x = near_surface(morph, t)
        exact = morph.morph.motion(x, t)
        assert (morph.morph(x, t) - exact).abs().max() > 3e-3
        assert (morph(x, t) - exact).abs().max() < {2: 3e-5, 3: 5e-4}[dim]


def test_the_error_falls_as_the_lattices_get_finer():
    def errors(**settings):
        morph = repaired(2, **settings)
        x = near_surface(morph, 0.5)
        return (morph(x, 0.5) - morph.morph.motion(x, 0.5)).abs().max()

    assert errors(detail=256) < errors(detail=128) / 4
    measured = [repaired(2, flow=n).flow_error() for n in (4, 24)]
    assert measured[1].mean < min(1e-6, measured[0].mean + 1e-9)
    assert measured[1].maximum < 1e-5
    assert measured[1].field < 2e-5


@both_dims
@pytest.mark.parametrize("t", [0.01, 0.3, 0.5, 0.98])
def test_the_gradient_is_that_of_the_value(t, dim):
    morph = repaired(dim)
    x = near_surface(morph, t, 200, 0.05)
    gradient = morph.gradient(x, t)
    for axis, step in enumerate(1e-6 * torch.eye(dim, dtype=torch.float64)):
        difference = (morph(x + step, t) - morph(x - step, t)) / 2e-6
        assert torch.allclose(gradient[:, axis], difference, atol=1e-5)


@pytest.mark.parametrize(("count", "close"), [(3, 1e-10), (18, 1e-4)])
def test_each_point_may_have_a_time_of_its_own(count, close):
    morph = repaired(2, flow=24)
    x = near_surface(morph, 0.5, 18)
    t = torch.linspace(0, 1, count, dtype=torch.float64).repeat(18 // count)
    alone = [(morph(y[None], s), morph.gradient(y[None], s)) for y, s in zip(x, t.tolist(), strict=True)]
    values, gradients = (torch.cat(parts) for parts in zip(*alone, strict=True))
    assert torch.allclose(morph(x, t), values, atol=close)
    assert torch.allclose(morph.gradient(x, t), gradients, atol=10 * close)


@both_dims
def test_away_from_the_surface_f_stays_as_it_is(dim):
    morph = repaired(dim)
    x = 2 * torch.rand(4000, dim, dtype=torch.float64) - 1
    for t in (0.2, 0.5):
        bare, exact = morph.morph(x, t), morph.morph.motion(x, t)
        far = torch.minimum(bare.abs(), exact.abs()) > {2: 0.15, 3: 0.25}[dim]
        assert torch.equal(morph(x[far], t), bare[far])
        # no other sign than that of f or of what f should be
        assert bool(((morph(x, t) < 0) == (bare < 0))[(bare < 0) == (exact < 0)].all())


@both_dims
def test_values_go_smoothly_into_those_of_the_ends(dim):
    morph = repaired(dim)
    for t in (0.0, 0.02, 0.04, 0.3):
        x = near_surface(morph, t, width=0.002)
        assert torch.allclose(rate(morph, x, t), morph.morph.motion.rate(x, t), atol={2: 0.005, 3: 0.03}[dim])
    far = 2 * torch.rand(400, dim, dtype=torch.float64) - 1
    assert torch.allclose(rate(morph, far, 0.0), rate(morph.morph, far, 0.0), atol=0.05)


def test_a_leftover_at_an_end_goes():
    motion = squashed_ball(2)

    class Leftover(Missing):
        def missing(self, x, t):
            ball = (x - x.new_tensor([0.7, -0.7])).norm(dim=1) - 0.12
            return (self.motion(x, t) - ball).clamp(min=0)

    morph = ExactEnds(Leftover(motion), 24, 128)
    inside = torch.tensor([[0.7, -0.7]], dtype=torch.float64)
    assert morph.morph(inside, 0.01) < 0
    assert morph(inside, 0.01) > 0.1


@both_dims
def test_volume_growth_and_transport_take_it(dim):
    morph, resolution = repaired(dim), {2: 96, 3: 40}[dim]
    motion = morph.morph.motion
    for t in (0.0, 0.5, 1.0):
        found = volume(partial(morph, t=t), morph.bounds, resolution)
        assert found == pytest.approx(motion.volume(t), rel=2e-3)
    level = ExactVolume(morph, resolution)(0.5)
    mesh = extract_frame(morph, 0.5, resolution, level).mesh
    assert enclosed_volume(mesh) == pytest.approx(volume(morph.source, morph.bounds, 96), rel=5e-3)

    grown = Grown(morph, VolumeLinear(dim, 1.0, 0.5))
    found = volume(partial(grown, t=1.0), grown.bounds, resolution)
    assert found == pytest.approx(motion.volume(1.0) / 2, rel=3e-3)
    x = near_surface(morph, 0.5, 20)
    scale = grown.growth.scale(0.5)
    assert torch.allclose(grown(scale * x, 0.5), scale * morph(x, 0.5))
    assert torch.allclose(grown.gradient(scale * x, 0.5), morph.gradient(x, 0.5))

    advected = advect_surface(morph, [0.5, 1.0], 24, RungeKutta(8))
    for t, vertices in zip(advected.times, advected.vertices, strict=True):
        assert morph(vertices, t).abs().max() < 4e-3
    assert torch.equal(morph.velocity(x, 0.5), motion.velocity(x, 0.5))
    assert torch.equal(morph.divergence(x, 0.5), motion.divergence(x, 0.5))


def test_without_a_velocity_detail_cannot_be_advected():
    with pytest.raises(InputError, match="must have a velocity"):
        ExactEnds(shrinking(2, 0.1))
