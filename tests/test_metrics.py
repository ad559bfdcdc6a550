"""Figures of morphs whose figures are known."""

from __future__ import annotations

import io
import json
import math
from functools import partial

import pytest
import torch
from problems import MOTIONS, Ball, LinearMotion
from rich.console import Console

from nsm import calculus
from nsm.metrics import evaluate_morph, table, volume_curve
from nsm.metrics.endpoint import angles, endpoint_errors, finite_gradient
from nsm.metrics.residuals import surface_residuals
from nsm.metrics.topology import surface_topology
from nsm.types import Morph


class Nothing(LinearMotion):
    """A morph that has collapsed: positive everywhere."""

    def __call__(self, x, t):
        return super().__call__(x, t).abs() + 1

    def velocity(self, x, t):
        return None


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", MOTIONS)
def test_the_exact_motions_are_what_they_say(name, dim, generator):
    """∇f, ∂f/∂t and the Jacobian of V against differences; so the tests stand on solid ground."""
    motion = MOTIONS[name](dim)
    assert isinstance(motion, Morph)
    x = torch.rand(200, dim, generator=generator, dtype=torch.double) * 1.6 - 0.8
    t = torch.rand(200, generator=generator, dtype=torch.double)
    h = 1e-6
    near_kink = (motion.gradient(x + h, t) - motion.gradient(x - h, t)).norm(dim=1) > 1e-3
    assert near_kink.sum() < 20
    x, t = x[~near_kink], t[~near_kink]
    assert finite_gradient(partial(motion, t=t), x, h) == pytest.approx(motion.gradient(x, t), abs=1e-6)
    assert (motion(x, t + h) - motion(x, t - h)) / (2 * h) == pytest.approx(motion.rate(x, t), abs=1e-6)
    shifts = h * torch.eye(dim, dtype=torch.double)
    columns = [(motion.velocity(x + s, t) - motion.velocity(x - s, t)) / (2 * h) for s in shifts]
    assert torch.stack(columns, 2) == pytest.approx(motion.velocity_jacobian(x, t), abs=1e-6)
    if motion.is_distance:
        assert motion.gradient(x, t).norm(dim=1) == pytest.approx(torch.ones(len(x)), abs=1e-9)


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
def test_a_ball_of_the_wrong_size_is_that_far_away(dim):
    """The end is 0.05 too small: so are all distances, and f scaled by 1/4 changes none of them."""
    motion = MOTIONS["translating_ball"](dim)
    motion_at_end = partial(Ball(dim, 0.45).jet)
    centre = motion.start + motion.drift

    class Faint(LinearMotion):
        def __call__(self, x, t):
            return super().__call__(x, t) / 4

    for morph in (motion, Faint(Ball(dim), drift=motion.drift.tolist(), start=motion.start.tolist())):
        errors = endpoint_errors(morph, 1.0, lambda x: motion_at_end(x - centre).value, 64, 64)
        for way in (errors.morph_to_shape, errors.shape_to_morph):
            assert way == pytest.approx((0.05, 0.05, 0.05), abs=1e-3)
        assert errors.chamfer == pytest.approx(0.05, abs=1e-3)
        assert errors.hausdorff == pytest.approx(0.05, abs=1e-3)
        assert errors.normal_error < 1
        assert errors.volume_error == pytest.approx((0.40 / 0.45) ** dim - 1, abs=1e-3)


def test_normals_of_a_disk_beside_its_place():
    """At angle φ the nearest normal differs by 0.05 |sin φ| / 0.4, whose mean is 2/π of the greatest."""
    motion = MOTIONS["translating_ball"](2)
    errors = endpoint_errors(motion, 0.0, lambda x: motion.source(x - x.new_tensor([0.05, 0])), 64)
    assert errors.normal_error == pytest.approx(math.degrees(0.05 / 0.4 * 2 / math.pi), rel=0.02)


def test_angles_are_exact_where_they_are_small():
    a = torch.tensor([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]], dtype=torch.float32)
    b = torch.tensor([[1.0, 1e-5], [0.0, 1.0], [-1.0, 0.0]], dtype=torch.float32)
    assert angles(a, b) == pytest.approx(torch.tensor([1e-5, math.pi / 2, math.pi]), rel=1e-4)


@pytest.mark.parametrize("dim", [2, 3])
def test_residuals_of_exact_motions_vanish(dim):
    for name in ("translating_ball", "rotating_box", "growing_ball"):
        for time in (0.0, 0.5, 1.0):
            residuals = surface_residuals(MOTIONS[name](dim), time, 32)
            assert residuals.gradient_norm == pytest.approx(1, abs=1e-6)
            assert residuals.gradient_norm_std < 1e-6
            assert residuals.level_set < 2e-3


def test_a_wrong_velocity_leaves_the_surface_behind():
    class Late(LinearMotion):
        def velocity(self, x, t):
            return super().velocity(x, t) / 2

    late = Late(Ball(2), drift=[0.6, 0.0], start=[-0.3, 0.0])
    # half the drift is missing: 0.3 |cos φ|, whose mean over the circle is 0.3 · 2/π
    assert surface_residuals(late, 0.5, 64).level_set == pytest.approx(0.6 / math.pi, rel=0.02)


def test_crumbs_count_as_components_and_weigh_little():
    class Crumbled(LinearMotion):
        def __call__(self, x, t):
            crumb = (x - 0.7).norm(dim=1) - 0.03
            return torch.minimum(super().__call__(x, t), crumb) if t == 0.5 else super().__call__(x, t)

    morph = Crumbled(Ball(3))
    assert surface_topology(morph, 0.0, 64)[1:4] == (1, 2, 1.0)
    _, components, euler, share, _ = surface_topology(morph, 0.5, 64)
    assert (components, euler) == (2, 4)
    assert share == pytest.approx(1 - (0.03 / 0.4) ** 2, abs=3e-3)


def test_the_protocol_gives_the_known_figures_of_the_authors_morph(data_dir):
    """kitten → fandisk as its authors trained it: volume, distance, normals, ‖∇f‖ and roughness."""

    def layers(path, omega):
        state = torch.load(data_dir / "official" / path, weights_only=True, map_location="cpu")
        tensors = list(state.values())
        return tuple(omega * tensor for tensor in tensors[:-2]) + tuple(tensors[-2:])

    network = layers("morphs/kitten-fandisk/best.pth", 1.0)
    fandisk = layers("ni/fandisk.pth", 60.0)

    class Official(LinearMotion):
        def _input(self, x, t):
            return torch.cat([x, torch.full_like(x[:, :1], t)], 1)

        def __call__(self, x, t):
            return calculus.value(network, self._input(x, t))[:, 0]

        def gradient(self, x, t):
            return calculus.value_and_gradient(network, self._input(x, t)).gradient[:, :3]

        def velocity(self, x, t):
            return None

    morph = Official(Ball(3), dtype=torch.float32)
    assert volume_curve(morph, torch.tensor([0.0, 0.4])).maximum_deviation == pytest.approx(0.0062, abs=1e-4)
    end = endpoint_errors(morph, 1.0, lambda x: calculus.value(fandisk, x)[:, 0])
    assert end.morph_to_shape[:2] == pytest.approx((0.0035, 0.0114), abs=4e-4)
    assert end.normal_error == pytest.approx(6.7, abs=0.2)
    assert surface_residuals(morph, 0.5).gradient_norm == pytest.approx(0.75, abs=0.01)
    halfway = surface_topology(morph, 0.5)
    assert (halfway.components, halfway.euler) == (1, 2)
    assert halfway.roughness == pytest.approx(3.0, abs=0.05)


@pytest.mark.parametrize("dim", [2, 3])
def test_all_figures_of_a_perfect_morph(dim):
    stages = []
    morph = MOTIONS["translating_ball"](dim)
    result = evaluate_morph(morph, volume_resolution=32, surface_resolution=32, times=3, progress=stages.append)
    figures = result.figures()
    assert len(stages) == 5
    assert figures["volume max"] < 2e-3
    assert figures["morph to shape t=0"] < 1e-6
    assert figures["normal error t=1"] < 0.1
    assert figures["most components"] == figures["fewest components"] == 1
    assert all(s.euler == (2 if dim == 3 else 0) for s in result.topology)
    again = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert again["figures"] == pytest.approx(figures)


def test_a_morph_that_is_gone_is_still_measured():
    """No surface, no velocity: nothing fails, and what is not defined is None in JSON."""
    gone = Nothing(Ball(3))
    gone.source = gone.target = lambda x: Ball(3).jet(x).value
    result = evaluate_morph(gone, volume_resolution=16, surface_resolution=16, times=3)
    figures = json.loads(json.dumps(result.to_dict(), allow_nan=False))["figures"]
    assert figures["volume std"] is None
    assert figures["morph to shape t=0"] is None
    assert figures["volume error t=0"] == pytest.approx(-1)
    assert figures["most components"] == 0


def test_the_table_has_a_column_a_run_and_a_row_a_figure():
    runs = {"ours": {"volume std": 0.00123, "normal error t=0": 3.21}, "theirs": {"volume std": None}}
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(table(runs, "two runs"))
    text = console.export_text()
    assert all(word in text for word in ("two runs", "ours", "theirs", "volume std", "0.0012", "3.2°"))
