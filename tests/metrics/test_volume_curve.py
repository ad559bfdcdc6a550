"""Volume over time against volumes that are known."""

from __future__ import annotations

import pytest
import torch
from measured import COARSE, advected
from omegaconf import OmegaConf
from problems import MOTIONS, Ball, LinearMotion

from nsm.cli.configuration import CONF
from nsm.geometry.volume import VOLUME_RESOLUTION
from nsm.metrics import evaluate_morph, volume_curve
from nsm.metrics.endpoint import SURFACE_RESOLUTION
from nsm.morphs.growth import Grown, VolumeLinear


@pytest.mark.parametrize("dim", [2, 3])
def test_volume_curve_of_a_growing_ball(dim):
    motion = MOTIONS["growing_ball"](dim)
    curve = volume_curve(motion, resolution=48)
    exact = torch.tensor([motion.volume(t) for t in curve.times.tolist()], dtype=torch.double)
    assert curve.times.tolist() == [k / 10 for k in range(11)]
    assert curve.volumes == pytest.approx(exact, rel=1e-3)
    assert curve.maximum_deviation == pytest.approx(float(exact[-1] / exact[0] - 1), rel=1e-3)
    assert curve.relative_std == pytest.approx(float(exact.std() / exact[0]), rel=1e-3)


@pytest.mark.parametrize("dim", [2, 3])
def test_volume_curve_of_a_squash_is_flat(dim):
    assert volume_curve(MOTIONS["squashed_ball"](dim), resolution=48).maximum_deviation < 1e-3


@pytest.mark.parametrize("dim", [2, 3])
def test_a_growth_that_is_wanted_is_no_deviation(dim):
    grown = Grown(MOTIONS["squashed_ball"](dim), VolumeLinear(dim, 1.0, 0.5))
    curve = volume_curve(grown, torch.tensor([0.0, 0.5, 1.0]), resolution=48)
    assert curve.volumes[-1] / curve.volumes[0] == pytest.approx(0.5, rel=1e-3)
    assert curve.maximum_deviation < 1e-3
    times = [0.0, 0.5, 1.0]
    check = advected(grown, times, 32)
    assert check.drift < 1e-5
    assert check.mean_distance < 2 / 32 / 8


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", ["growing_ball", "rotating_box"])
def test_the_error_that_a_volume_states_covers_the_one_it_has(name, dim):
    motion = MOTIONS[name](dim)
    curve = volume_curve(motion, torch.tensor([0.0, 0.3, 0.6, 1.0]), resolution=48)
    exact = torch.tensor([motion.volume(t) for t in curve.times.tolist()], dtype=torch.double)
    # at one time two grids may agree by chance; over all times the greatest is what counts
    assert float(((curve.volumes - exact) / exact).abs().max()) <= curve.relative_error + 1e-6
    assert curve.relative_error < 0.01


def test_volume_that_leaves_the_box_is_reported_and_not_only_lost() -> None:
    """A ball ends with half of itself outside: the curve loses half of it, and the figure says where it is."""
    leaving = LinearMotion(Ball(2, 0.3), drift=[1.0, 0.0])
    figures = evaluate_morph(leaving, COARSE).figures()
    assert figures["volume max"] == pytest.approx(0.5, abs=0.02)
    assert figures["volume beyond"] == pytest.approx(0.5, abs=0.05)
    staying = LinearMotion(Ball(2, 0.3), drift=[0.5, 0.0])
    assert evaluate_morph(staying, COARSE).figures()["volume beyond"] == 0


@pytest.mark.parametrize("file", ["evaluate.yaml", "compare.yaml", "task/ot.yaml"])
def test_commands_measure_volumes_at_the_default_resolution(file):
    settings = OmegaConf.load(CONF / file)
    assert settings.volume_resolution == VOLUME_RESOLUTION
    assert settings.get("surface_resolution", SURFACE_RESOLUTION) == SURFACE_RESOLUTION
