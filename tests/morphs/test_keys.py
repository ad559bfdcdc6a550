"""Morphs through more than two shapes: legs, exact keys, growth through the keys' own volumes."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import pytest
import torch
from problems import rotating_box, squashed_ball
from test_exact_ends import Missing, near_surface

from nsm import ExactEnds, ExactKeys
from nsm.cli.errors import InputError
from nsm.fields import AdaDiv, Gaussian, Nise, ScalarSiren, VectorSiren
from nsm.geometry.volume import volume
from nsm.io.loading import exact_ends
from nsm.metrics.residuals import rate
from nsm.morphs.file_coordinates import FileCoordinates
from nsm.morphs.growth import Grown, Table
from nsm.morphs.leg import Leg, legs
from nsm.morphs.neural import NeuralMorph, key_times
from nsm.shapes import Ball, Similarity
from nsm.types import Key

#: Times of the keys below.
MOMENTS = (0.0, 0.3, 1.0)


class MissingAtKeys(Missing):
    """A motion through three keys whose f lacks bumps at each of them, which the flow advects to the next ones."""

    @property
    def keys(self):
        return tuple(Key(time, partial(self.motion, t=time)) for time in MOMENTS)

    def missing(self, x, t):
        """Σ wᵢ(t) bᵢ(φ_{t→tᵢ}(x)) over the keys before and after t, with the weights cos² and sin² of each leg."""
        t = torch.as_tensor(t).to(x).expand(len(x))
        start = self.motion._back(x, t)[0]
        total = torch.zeros_like(t)
        for number, (before, after) in enumerate(pairwise(MOMENTS)):
            here = (t >= before) & ((t < after) | (after == 1))
            share = (t - before) / (after - before)
            for key, time, weight in (
                (number, before, (torch.pi / 2 * share).cos() ** 2),
                (number + 1, after, (torch.pi / 2 * share).sin() ** 2),
            ):
                there = start @ torch.matrix_exp(time * self.motion.matrix).T
                total = total + here * weight * 0.01 * ((4 + key) * there + key).sin().prod(1)
        return total


class Whole(MissingAtKeys):
    """The same motion with nothing missing."""

    def missing(self, x, t):
        return 0 * x[:, 0]


def through_balls(*radii: float, times: tuple[float, ...] | None = None) -> NeuralMorph:
    """A morph of random weights through balls about the origin."""
    torch.manual_seed(0)
    network = partial(VectorSiren, hidden_features=8, hidden_layers=1, omega=4.0)
    first, *between, last = (Ball(radius) for radius in radii)
    velocity = AdaDiv(3, network, Gaussian())
    return NeuralMorph(ScalarSiren(4, 8, 1, omega=4.0), velocity, first, last, 1.0, between, times).requires_grad_(
        False
    )


@pytest.mark.parametrize("number", [0, 1])
def test_a_leg_is_advected_by_its_own_velocity(number):
    morph = Whole(squashed_ball(3))
    leg = Leg(morph, number)
    x = 0.8 * (2 * torch.rand(200, 3, dtype=torch.float64) - 1)
    for s in (0.25, 0.5):
        residual = rate(leg, x, s) + (leg.gradient(x, s) * leg.velocity(x, s)).sum(1)
        assert residual.abs().max() < 1e-5
        assert torch.allclose(leg.divergence(x, s), (MOMENTS[number + 1] - MOMENTS[number]) * morph.divergence(x, s))
        assert torch.equal(leg(x, s), morph(x, MOMENTS[number] + s * (MOMENTS[number + 1] - MOMENTS[number])))
        assert leg.outer_time(leg.own_time(0.4)) == pytest.approx(0.4)
    assert [key.shape for key in leg.keys] == [leg.source, leg.target]


@pytest.mark.parametrize("motion", [squashed_ball, rotating_box])
def test_every_key_is_exact_and_its_detail_is_advected_both_ways(motion):
    morph = ExactKeys(MissingAtKeys(motion(2)))
    x = 2 * torch.rand(100, 2, dtype=torch.float64) - 1
    for key in morph.keys:
        assert torch.equal(morph(x, key.time), key.shape(x))
        assert not torch.allclose(morph.morph(x, key.time), key.shape(x), atol=1e-3)
        assert torch.equal(morph(x, torch.full((100,), key.time, dtype=torch.double)), key.shape(x))
    for t in (0.02, 0.15, 0.29, 0.31, 0.6, 0.97):
        y = near_surface(morph, t)
        exact = morph.morph.motion(y, t)
        assert (morph.morph(y, t) - exact).abs().max() > 3e-3
        assert (morph(y, t) - exact).abs().max() < 3e-5
        # the gradient of a box jumps at its diagonals, over which differences reach
        wrong = (morph.gradient(y, t) - morph.morph.motion.gradient(y, t)).norm(dim=1) > 2e-2
        assert wrong.double().mean() < 0.03
    assert morph.flow_error().field < 2e-5


def test_points_may_have_times_on_both_sides_of_a_key():
    morph = ExactKeys(MissingAtKeys(squashed_ball(2)))
    x, t = near_surface(morph, 0.3, 12), torch.tensor([0.1, 0.3, 0.8], dtype=torch.float64).repeat(4)
    values, gradients = morph(x, t), morph.gradient(x, t)
    for number, time in enumerate(t[:3].tolist()):
        assert torch.allclose(values[number::3], morph(x[number::3], time), atol=1e-10)
        assert torch.allclose(gradients[number::3], morph.gradient(x[number::3], time), atol=1e-10)


def test_the_loader_chooses_by_the_number_of_keys():
    assert isinstance(exact_ends(through_balls(0.4, 0.4), "a"), ExactEnds)
    assert isinstance(exact_ends(through_balls(0.4, 0.5, 0.4), "a"), ExactKeys)
    with pytest.raises(InputError, match=r"^`morph` must pass through two shapes to have exact ends, got 3\. Try"):
        ExactEnds(through_balls(0.4, 0.5, 0.4))


def test_keys_are_evenly_spaced_unless_their_times_are_given():
    assert key_times(None, 4) == (0.0, 0.333333, 0.666667, 1.0)
    assert [key.time for key in through_balls(0.4, 0.5, 0.6, times=(0, 0.4, 1)).keys] == [0, 0.4, 1]
    for wrong in ([0, 1], [0, 0.5, 0.9], [0, 1, 0.5], [0, float("nan"), 1]):
        with pytest.raises(InputError, match=r"^`times` must be .* got .*\. Try `times=\[0,0\.5,1\]`"):
            key_times(wrong, 3)


def test_a_velocity_that_leads_to_the_target_passes_no_keys():
    with pytest.raises(InputError, match=r"^`between` must be empty .*, got 1 shapes between\. Try `method=adadiv`"):
        NeuralMorph(ScalarSiren(4, 8, 1), Nise(3), Ball(0.4), Ball(0.4), between=[Ball(0.5)])


def test_a_growth_goes_through_the_own_volumes_of_all_keys():
    times, volumes = (0.0, 0.4, 1.0), (1.0, 2.0, 1.5)
    morph = through_balls(0.3, 0.3, 0.3, times=times)
    grown = Grown(morph, Table(3, own=dict(zip(times, volumes, strict=True))))
    for key, expected in zip(grown.keys, volumes, strict=True):
        assert volume(key.shape, grown.bounds, 64) == pytest.approx(expected * Ball(0.3).volume(), rel=2e-3)
        assert grown.wanted_volume(key.time) == pytest.approx(expected)
    with pytest.raises(InputError, match=r"^`growth.volumes` must be positive and finite, got nothing\."):
        Table(3, times=[0, 0.5, 1], volumes=[None, None, None])


def test_file_coordinates_move_every_key():
    morph = through_balls(0.3, 0.4, 0.5)
    morph.source = Ball(0.3).transformed(Similarity.read({"scale": 0.5, "translation": [0.1, 0, 0]}, 3))
    in_file = FileCoordinates(morph, "source")
    inside = in_file.to_file.apply(torch.tensor([[0.0, 0.0, 0.4]], dtype=torch.double))
    assert in_file.keys[1].shape(inside) == pytest.approx(0.0, abs=1e-5)
    assert [key.time for key in legs(in_file)[0].keys] == [0.0, 1.0]
