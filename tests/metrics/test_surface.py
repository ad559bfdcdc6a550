"""Figures of the moving surface against those that are known."""

from __future__ import annotations

import math

import pytest
import torch
from measured import COARSE, Still, surface_at
from problems import MOTIONS, Ball, LinearMotion

from nsm.metrics import evaluate_morph
from nsm.metrics.motion import Motion


@pytest.mark.parametrize("dim", [2, 3])
def test_figures_of_a_growing_ball(dim):
    """Radius r = 0.4 + 0.3 t, speed 0.3, div V = 0.3 (d − 1) / r on it."""
    motion = MOTIONS["growing_ball"](dim)
    for time in (0.0, 0.6, 1.0):
        radius = 0.4 + 0.3 * time
        figures = surface_at(motion, time, 64)
        assert figures.speed == pytest.approx(0.3, rel=1e-6)
        assert figures.divergence == pytest.approx(0.3 * (dim - 1) / radius, rel=2e-3)
        assert figures.area == pytest.approx(dim * Ball(dim, radius).volume / radius, rel=5e-3)
        assert (figures.components, figures.genus, figures.largest_share) == (1, 0, 1.0)


def test_crumbs_count_as_components_and_weigh_little():
    def crumbled(x, t):
        ball, crumb = Ball(3).jet(x).value, (x - 0.7).norm(dim=1) - 0.03
        return torch.minimum(ball, crumb) if t == 0.5 else ball

    morph = Still(3, crumbled)
    whole, halfway = surface_at(morph, 0.0, 64), surface_at(morph, 0.5, 64)
    assert (whole.components, whole.pieces, whole.euler, whole.genus, whole.largest_share) == (1, 1, 2, 0, 1.0)
    # the crumb encloses 4e-4 of the volume: it can be seen
    assert (halfway.components, halfway.pieces, halfway.euler, halfway.genus) == (2, 2, 4, 0)
    assert halfway.largest_share == pytest.approx(1 - (0.03 / 0.4) ** 2, abs=3e-3)


def test_an_even_motion_and_one_in_the_middle():
    times = [k / 10 for k in range(11)]
    even = Motion(times, [0.3] * 11)
    assert (even.distance, even.unevenness, even.middle_share) == pytest.approx((0.3, 1.0, 0.5))
    # a hat from ¼ to ¾, of height 2: all of the motion, at 4 times the mean speed
    hat = Motion([0.0, 0.25, 0.5, 0.75, 1.0], [0.0, 0.0, 2.0, 0.0, 0.0])
    assert (hat.distance, hat.unevenness, hat.middle_share) == pytest.approx((0.5, 4.0, 1.0))
    # speed t between two times: ∫ from ¼ to ¾ is ¼
    assert Motion([0.0, 1.0], [0.0, 1.0]).distance_between(0.25, 0.75) == pytest.approx(0.25)
    assert math.isnan(Motion([0.0, 1.0], [0.0, 0.0]).unevenness)


def test_roughness_between_the_ends_is_relative_to_the_rougher_end() -> None:
    still = LinearMotion(Ball(2, 0.4))
    figures = evaluate_morph(still, COARSE).figures()
    assert figures["roughness at 1/2"] == pytest.approx(1)
    assert (figures["fewest pieces"], figures["most pieces"]) == (1, 1)

    def rippled(x: torch.Tensor, t: float) -> torch.Tensor:
        angle = torch.atan2(x[:, 1], x[:, 0])
        return x.norm(dim=1) - 0.6 - 0.05 * math.sin(math.pi * t) * torch.cos(12 * angle)

    assert evaluate_morph(Still(2, rippled), COARSE).figures()["roughness at 1/2"] > 1.5
