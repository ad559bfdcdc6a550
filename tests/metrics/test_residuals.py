"""Residuals of both equations, and the divergence, against exact ones."""

from __future__ import annotations

import math

import pytest
import torch
from measured import Nothing, Still, surface_at
from problems import MOTIONS, Ball, LinearMotion

from nsm.metrics.residuals import SAMPLES, divergence, level_set_residual, rate, space_residuals


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", MOTIONS)
def test_the_equations_of_exact_motions_hold_everywhere(name, dim):
    motion = MOTIONS[name](dim)
    for time in (0.0, 0.5):
        figures = surface_at(motion, time, 24)
        shell, box = space_residuals(motion, time, 0.1)
        # a few points of a box come nearest to another face within a step of the difference in time
        assert max(figures.level_set, shell.level_set, box.level_set) < (1e-3 if "box" in name else 1e-4)
        if motion.is_distance:
            assert figures.gradient_norm == pytest.approx(1, abs=1e-9)
            assert max(figures.gradient_norm_std, shell.eikonal, box.eikonal) < 1e-9


@pytest.mark.parametrize("dim", [2, 3])
def test_the_rate_is_of_second_order_at_the_ends_too(dim, generator):
    motion = MOTIONS["squashed_ball"](dim)
    x = torch.rand(200, dim, generator=generator, dtype=torch.double) - 0.5
    for time in (0.0, 5e-4, 0.4, 1.0):
        assert rate(motion, x, time) == pytest.approx(motion.rate(x, time), abs=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_scaling_f_changes_no_residual_of_the_level_set(dim):
    """f scaled by 1/4 is further from a distance, and no closer to being carried."""

    class Late(LinearMotion):
        size = 1.0

        def __call__(self, x, t):
            return self.size * super().__call__(x, t)

        def gradient(self, x, t):
            return self.size * super().gradient(x, t)

        def velocity(self, x, t):
            return super().velocity(x, t) / 2

    late, faint = (Late(Ball(dim), drift=[0.6] + [0.0] * (dim - 1)) for _ in range(2))
    faint.size = 0.25
    widths = (0.1, 0.025)
    (shell, box), (faint_shell, faint_box) = (
        space_residuals(m, 0.5, w) for m, w in zip((late, faint), widths, strict=True)
    )
    assert faint_shell.points == shell.points > 1000
    assert (faint_shell.level_set, faint_box.level_set) == pytest.approx((shell.level_set, box.level_set))
    assert (faint_shell.eikonal, faint_box.eikonal) == pytest.approx((0.75, 0.75))
    # half the drift is missing: 0.3 |cos φ|, whose mean is 2/π of that on a circle and ½ on a sphere
    assert surface_at(late, 0.5, 64).level_set == pytest.approx(0.3 * {2: 2 / math.pi, 3: 0.5}[dim], rel=0.02)
    assert surface_at(faint, 0.5, 64).level_set == pytest.approx(surface_at(late, 0.5, 64).level_set, rel=1e-3)


@pytest.mark.parametrize("dim", [2, 3])
def test_divergence_by_differences_is_the_exact_one(dim, generator):
    motion = MOTIONS["growing_ball"](dim)

    class Silent(Still):
        has_velocity = True

        def velocity(self, x, t):
            return motion.velocity(x, t)

    x = torch.rand(200, dim, generator=generator, dtype=torch.double) * 0.5 + 0.2
    assert divergence(motion, x, 0.3) == pytest.approx(motion.divergence(x, 0.3))
    assert divergence(Silent(dim, motion), x, 0.3) == pytest.approx(motion.divergence(x, 0.3), rel=1e-4)
    assert divergence(Still(dim, motion), x, 0.3) is None
    assert level_set_residual(Still(dim, motion), x, 0.3) is None


def test_the_shell_is_next_to_the_surface():
    """f = |x|² − ¼ has ‖∇f‖ = 2|x|: in the shell |f| < 0.01 that is within 0.02 of 1, in the box it is not."""
    shell, box = space_residuals(Still(2, lambda x, t: x.square().sum(1) - 0.25), 0.0, 0.01)
    assert 0.005 < shell.eikonal < 0.02
    assert shell.points > 500
    # ∫ |2|x| − 1| over the square, by Monte Carlo with 10⁷ points
    assert box.eikonal == pytest.approx(0.6612, abs=0.02)
    assert box.points == SAMPLES
    # a wider shell has as many points as were asked for, which are drawn until they are found
    shell, box = space_residuals(Still(2, lambda x, t: x.square().sum(1) - 0.25), 0.0, 0.1, samples=300)
    assert (shell.points, box.points) == (300, 300)
    empty = space_residuals(Nothing(Ball(2)), 0.0).shell
    assert empty.points == 0
    assert math.isnan(empty.eikonal)
