"""Jacobian determinants of flows that are known, and their export and figures."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from problems import MOTIONS, Ball, GrowingBall, LinearMotion, trajectory

from nsm.export.formats import FORMATS
from nsm.export.request import Request
from nsm.geometry.advection import RungeKutta
from nsm.geometry.jacobian import VolumeChange, trace_points
from nsm.metrics.interior import interior_change
from nsm.shapes import Ball as BallShape


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", MOTIONS)
def test_points_and_determinants_of_exact_motions(name: str, dim: int) -> None:
    motion = MOTIONS[name](dim)
    x = 0.1 + 0.5 * torch.rand(50, dim, dtype=torch.float64)
    traced = trace_points(motion.velocity, x, [0.0, 0.4, 1.0], 1e-3)
    for positions, determinants, time in zip(traced.positions, traced.determinants, [0.0, 0.4, 1.0], strict=True):
        torch.testing.assert_close(positions, trajectory(motion, x, time), atol=1e-6, rtol=0)
        if isinstance(motion, GrowingBall):
            exact = (1 + motion.growth * time / x.norm(dim=1)) ** (dim - 1)
        else:
            exact = torch.full((50,), math.exp(time * float(motion.matrix.trace()))).double()
        torch.testing.assert_close(determinants, exact, atol=2e-5, rtol=2e-5)


def test_a_turn_changes_no_volume_and_a_growth_does_as_wanted() -> None:
    still = interior_change(MOTIONS["rotating_box"](3))
    assert still.folded == 0
    assert max(abs(still.mean), still.std, still.maximum) < 1e-6
    growing = LinearMotion(Ball(2, 0.3), matrix=[[0.2, 0.0], [0.0, 0.2]])
    change = interior_change(growing)
    assert change.mean == pytest.approx(math.exp(0.4) - 1, rel=1e-5)
    assert change.std < 1e-6
    growing.wanted_volume = lambda t, initial=1.0: initial * math.exp(0.4 * t)
    assert interior_change(growing).maximum < 1e-5


def test_the_mean_determinant_is_the_growth_of_the_volume() -> None:
    motion = MOTIONS["growing_ball"](3)
    motion.velocity = lambda x, t: motion.growth * x / x.norm(dim=1, keepdim=True).clamp(min=1e-9)
    change = interior_change(motion)
    assert 1 + change.mean == pytest.approx(motion.volume(1.0) / motion.volume(0.0), rel=0.1)  # up to the hole inside
    assert change.std > 1


def test_a_map_that_folds_is_seen() -> None:
    def jump(x: torch.Tensor, t: float) -> torch.Tensor:
        return torch.stack([-2 * x[:, 0].relu(), 0 * x[:, 1]], 1) / 0.9  # in one step no flow, but a fold

    class Euler(RungeKutta):
        def advance(self, velocity, x, start, end):
            return x + (end - start) * velocity(x, start)

    x = torch.tensor([[-0.5, 0.1], [0.5, 0.1], [0.7, 0.0], [-0.2, 0.0]])
    traced = trace_points(jump, x, [0.0, 1.0], 1e-3, Euler(1))
    assert VolumeChange.of(traced.determinants[-1]).folded == 0.5
    torch.testing.assert_close(traced.determinants[-1][1], torch.tensor(1 - 2 / 0.9, dtype=torch.float64))


def test_percentiles() -> None:
    change = VolumeChange.of(1 + torch.linspace(0, 1, 101))
    assert change.percentiles == pytest.approx((0.01, 0.05, 0.5, 0.95, 0.99), abs=1e-6)
    assert change.maximum == pytest.approx(1)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_export_holds_the_points_in_both_files(dim: int, tmp_path: Path) -> None:
    motion = MOTIONS["squashed_ball"](dim)
    pose = {"scale": 0.1, "rotation": 30 if dim == 2 else [0, 0, 30]}
    motion.source, motion.target = (
        BallShape(4.0, [0.0] * dim, pose=pose),
        BallShape(0.2, [0.0] * dim, pose={"scale": 2}),
    )
    request = Request(motion, tmp_path, [0.0, 0.5, 1.0], resolution=8, coordinates="target")
    FORMATS["interior"].export(request)
    with np.load(tmp_path / "interior.npz") as found:
        start = 2 * torch.from_numpy(found["positions"][0])
        assert (motion(start, 0.0) < 0).all()
        for position, time in zip(found["positions"], found["times"], strict=True):
            assert 2 * position == pytest.approx(trajectory(motion, start, float(time)).numpy(), abs=1e-6)
        assert found["determinants"] == pytest.approx(1, abs=1e-5)
        assert found["source_in_file"] == pytest.approx(motion.source.similarity.pull_back(start).numpy(), abs=1e-6)
        assert found["target_in_file"] == pytest.approx(found["positions"][-1], abs=1e-6)
    record = json.loads((tmp_path / "interior.json").read_text())
    assert [entry["folded_share"] for entry in record["times"]] == [0, 0, 0]
    assert record["times"][2]["change_in_per_mille"]["maximum"] < 0.01
