"""Points advected by a velocity follow exact motions."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
import torch
from problems import MOTIONS, trajectory
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry import advection
from nsm.geometry.advection import RungeKutta, advect


def cloud(dim: int, count: int = 40) -> Tensor:
    """Points in [-0.8, 0.8]^d, none at the origin."""
    return 1.6 * torch.rand(count, dim, dtype=torch.float64) - 0.8


def swirl(x: Tensor, t: float) -> Tensor:
    """A motion without divergence that is linear in nothing: rotation by |x|² sin(t) about the origin."""
    return x.square().sum(1, keepdim=True) * math.cos(t) * torch.stack([-x[:, 1], x[:, 0]], 1)


def swirled(x: Tensor, t: float) -> Tensor:
    """Where `swirl` takes the points x of t = 0."""
    angle = x.square().sum(1) * math.sin(t)
    cos, sin = angle.cos(), angle.sin()
    return torch.stack([cos * x[:, 0] - sin * x[:, 1], sin * x[:, 0] + cos * x[:, 1]], 1)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", MOTIONS)
def test_points_follow_the_exact_motion(name: str, dim: int) -> None:
    motion, x, times = MOTIONS[name](dim), cloud(dim), [0.0, 0.3, 1.0]
    carried = advect(motion.velocity, x, times, RungeKutta(32))
    expected = torch.stack([trajectory(motion, x, t) for t in times])
    assert carried.shape == (3, 40, dim)
    assert carried.dtype == torch.float64
    assert torch.equal(carried[0], x)
    assert float((carried - expected).abs().max()) < 1e-7


def test_runge_kutta_has_order_four() -> None:
    x = cloud(2)
    errors = [
        float((advect(swirl, x, [0.0, 1.0], RungeKutta(steps))[-1] - swirled(x, 1.0)).abs().max())
        for steps in (4, 8, 16, 32)
    ]
    orders = [math.log2(a / b) for a, b in pairwise(errors)]
    assert all(3.7 < order < 4.5 for order in orders), orders


def test_forth_and_back_is_where_it_began() -> None:
    x = cloud(2)
    there_and_back = advect(swirl, x, [0.2, 1.0, 0.2], RungeKutta(64))
    assert float((there_and_back[2] - x).abs().max()) < 1e-6
    assert torch.equal(there_and_back[:2], advect(swirl, x, [0.2, 1.0], RungeKutta(64)))


def test_times_on_the_way_cost_no_accuracy() -> None:
    x = cloud(2)
    many = advect(swirl, x, torch.linspace(0, 1, 7), RungeKutta(32))
    assert float((many - torch.stack([swirled(x, t / 6) for t in range(7)])).abs().max()) < 1e-6


def test_chunks_change_nothing_and_progress_counts_them(monkeypatch: pytest.MonkeyPatch) -> None:
    x, told = cloud(2, 50), []
    whole = advect(swirl, x, [0.0, 0.5, 1.0], RungeKutta(4))
    monkeypatch.setattr(advection, "CHUNK", 20)
    parts = advect(swirl, x, [0.0, 0.5, 1.0], RungeKutta(4), progress=lambda done, total: told.append((done, total)))
    torch.testing.assert_close(parts, whole, rtol=0, atol=1e-14)
    assert told == [(done, 12) for done in range(1, 13)]


def test_single_precision_no_points_and_one_time() -> None:
    single = advect(swirl, cloud(2).float(), [0.0, 1.0])
    assert single.dtype == torch.float32
    assert advect(swirl, torch.empty(0, 2), [0.0, 1.0]).shape == (2, 0, 2)
    x = cloud(2)
    assert torch.equal(advect(swirl, x, [0.7]), x[None])
    assert torch.equal(advect(swirl, x, [0.7, 0.7])[1], x)


def test_no_graph_is_kept() -> None:
    x = cloud(2).requires_grad_()
    assert not advect(swirl, x, [0.0, 1.0], RungeKutta(2)).requires_grad


@pytest.mark.parametrize("times", [[], [0.0, math.nan], [math.inf]])
def test_times_must_be_finite(times: list[float]) -> None:
    with pytest.raises(InputError, match="`times` must be finite numbers"):
        advect(swirl, cloud(2), times)


@pytest.mark.parametrize("steps", [0, -1])
def test_the_number_of_steps_must_be_positive(steps: int) -> None:
    with pytest.raises(InputError, match=f"`steps` must be a positive integer, got {steps}"):
        RungeKutta(steps)
