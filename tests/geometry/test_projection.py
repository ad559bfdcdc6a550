"""Projection of points to a level set."""

from __future__ import annotations

import pytest
import torch
from problems import squashed_ball
from torch import Tensor

from nsm.geometry.advection import RungeKutta, advect
from nsm.geometry.meshing import extract_surface
from nsm.geometry.projection import newton_to_level, project_to_level
from nsm.morphs.advected import LevelProjection
from nsm.types import Jet


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("level", [0.0, 0.02])
def test_a_projection_lands_on_the_level(dim: int, level: float) -> None:
    motion = squashed_ball(dim)
    surface = extract_surface(lambda x: motion(x, 0.6), motion.bounds, 24, level).vertices
    x = surface + 0.01 * torch.randn_like(surface)
    projected = LevelProjection(motion, lambda time: level)(x, 0.6)
    assert float((motion(projected, 0.6) - level).abs().max()) < 1e-9
    # the closest points, but for the curvature
    way = projected - x
    gradient = torch.nn.functional.normalize(motion.gradient(projected, 0.6), dim=1)
    along = (way * gradient).sum(1, keepdim=True) * gradient
    assert float((way - along).norm(dim=1).max()) < 0.01


def test_what_cannot_be_projected_stays_and_is_reported() -> None:
    x = torch.tensor([[0.3, 0.0], [0.0, 0.0], [0.9, 0.0], [0.41, 0.0]], dtype=torch.float64)

    def jet(x: Tensor) -> Jet:  # a disk of radius 0.4, whose gradient is not a number in the middle
        norm = x.norm(dim=1)
        return Jet(norm - 0.4, x / norm[:, None])

    points, stayed = project_to_level(jet, x, reach=0.05)
    assert stayed.tolist() == [True, True, True, False]
    assert torch.equal(points[:3], x[:3])
    assert float(points[3, 0]) == pytest.approx(0.4)
    flat, stayed = project_to_level(lambda x: Jet(torch.ones(len(x)).to(x), torch.zeros_like(x)), x)
    assert bool(stayed.all())
    assert torch.equal(flat, x)


def test_points_that_are_on_the_level_are_not_evaluated_again() -> None:
    """One ball of two is a distance, at which a step arrives; the other is squared, and takes all steps."""
    seen: list[int] = []

    def jet(x: Tensor) -> Jet:
        seen.append(len(x))
        norm, far = x.norm(dim=1), x[:, 0] > 0
        value = torch.where(far, norm.square() - 0.25, norm - 0.5)
        return Jet(value, torch.where(far, 2.0, 1 / norm)[:, None] * x)

    x = torch.tensor([[-0.5, 0.0], [-0.52, 0.0], [0.55, 0.0]], dtype=torch.float64)
    points, _ = newton_to_level(jet, x, steps=3)
    assert seen == [3, 2, 1, 1]
    assert points[:, 0].tolist() == pytest.approx([-0.5, -0.5, 0.5], abs=1e-9)


def test_projected_points_stay_on_a_surface_that_few_steps_would_lose() -> None:
    motion = squashed_ball(3)
    start = extract_surface(lambda x: motion(x, 0.0), motion.bounds, 16).vertices
    on = LevelProjection(motion)(start, 0.0)
    times, method = [0.0, 0.5, 1.0], RungeKutta(2)
    lost = advect(motion.velocity, on, times, method)
    kept = advect(motion.velocity, on, times, method, LevelProjection(motion))
    off = [float(motion(x, 1.0).abs().max()) for x in (lost[-1], kept[-1])]
    assert off[1] < 1e-9 < 1e-6 < off[0]
