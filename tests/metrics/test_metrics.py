"""Figures of morphs whose figures are known."""

from __future__ import annotations

import json
import math
import sys
from functools import partial

import pytest
import torch
from problems import MOTIONS, Ball, LinearMotion

from nsm import calculus, shapes
from nsm.compare.results import Result
from nsm.compare.tabulate import figure_table, overview
from nsm.evaluate.tables import markdown_table
from nsm.geometry.meshing import extract_surface
from nsm.metrics import STAGES, Protocol, all_metrics, evaluate_morph, figures, find_metric, volume_curve
from nsm.metrics.advection import check_advection
from nsm.metrics.endpoint import angles, endpoint_errors, finite_gradient
from nsm.metrics.events import TIME_TOLERANCE, topology_events
from nsm.metrics.motion import Motion
from nsm.metrics.residuals import divergence, level_set_residual, rate, space_residuals
from nsm.metrics.surface import SurfaceFigures, surface_figures
from nsm.morphs.growth import Grown, VolumeLinear
from nsm.plots.tables import markdown
from nsm.shapes import Similarity
from nsm.types import Morph

#: As coarse as figures of simple shapes allow.
COARSE = Protocol(volume_resolution=24, surface_resolution=24, times=3)


def surface_at(morph, time, resolution=32) -> SurfaceFigures:
    return surface_figures(morph, time, extract_surface(partial(morph, t=time), morph.bounds, resolution))


def meshes_of(morph, times, resolution):
    return [extract_surface(partial(morph, t=t), morph.bounds, resolution) for t in times]


def carried(morph, times, resolution):
    meshes = meshes_of(morph, times, resolution)
    return check_advection(morph, meshes[0], times, meshes)


class Still(Morph):
    """Shapes that a function of time and space gives, without velocity: nothing but a `Morph`."""

    def __init__(self, dim, field):
        self.dim, self.field = dim, field
        self.bounds = torch.tensor([[-1.0] * dim, [1.0] * dim], dtype=torch.double)
        self.source, self.target = partial(self, t=0.0), partial(self, t=1.0)
        self.provenance = {}

    def __call__(self, x, t):
        return self.field(x, t)

    def gradient(self, x, t):
        return finite_gradient(partial(self.field, t=t), x, 1e-6)


class Nothing(LinearMotion):
    """A morph that has collapsed: positive everywhere."""

    has_velocity = False

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
    assert box.points == 1 << 13
    empty = space_residuals(Nothing(Ball(2)), 0.0).shell
    assert empty.points == 0
    assert math.isnan(empty.eikonal)


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


def two_balls(x, t):
    """Radius 0.3 about ±(0.5 − 0.35 t) e₁ from (0.1, 0.05, …): they touch there at t = 4/7."""
    shift = torch.zeros_like(x[:1])
    shift[0, 0] = 0.5 - 0.35 * t
    middle = torch.full_like(shift, 0.05) + torch.eye(x.shape[1], dtype=x.dtype)[:1] * 0.05
    return torch.minimum((x - middle - shift).norm(dim=1), (x - middle + shift).norm(dim=1)) - 0.3


def vanishing(x, t):
    """A ball stays, one of radius 0.3 (1 − t/0.62) about (0.5, 0.5, …) vanishes at t = 0.62."""
    return torch.minimum((x + 0.4).norm(dim=1) - 0.35, (x - 0.5).norm(dim=1) - 0.3 * (1 - t / 0.62))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    ("field", "time", "place"), [(two_balls, 4 / 7, (0.1, 0.05, 0.05)), (vanishing, 0.62, (0.5, 0.5, 0.5))]
)
def test_two_parts_become_one_when_and_where_they_do(field, time, place, dim):
    morph, times = Still(dim, field), [0.0, 0.5, 1.0]
    (event,) = topology_events(morph, times, meshes_of(morph, times, 64), 64)
    assert (event.components, event.genus) == ((2, 1), (0, 0))
    before, after = event.times
    assert after - before <= TIME_TOLERANCE
    # a ball or a gap smaller than a cell, 1/32, is not seen: it shrinks by 0.97 or 0.7 in a unit of time
    assert time - 1 / 32 / 0.7 < before < time + 0.002
    assert event.place == pytest.approx(place[:dim], abs=0.03)


def test_a_hole_that_closes_is_found_and_so_is_one_that_opens_again():
    """The tube of a torus reaches its middle, (0.1, −0.1, 0.05), at t = ¼ and leaves it at ¾."""
    middle = torch.tensor([0.1, -0.1, 0.05], dtype=torch.double)

    def torus(x, t):
        flat = x - middle
        ring = torch.stack([flat[:, :2].norm(dim=1) - 0.3, flat[:, 2]], 1)
        return ring.norm(dim=1) - 0.15 - 0.6 * min(t, 1 - t)

    morph, times = Still(3, torus), [0.0, 0.5, 1.0]
    closes, opens = topology_events(morph, times, meshes_of(morph, times, 48), 48)
    assert (closes.genus, opens.genus) == ((1, 0), (0, 1))
    assert closes.components == opens.components == (1, 1)
    for event, time in ((closes, 0.25), (opens, 0.75)):
        assert sum(event.times) / 2 == pytest.approx(time, abs=0.045)  # a gap below a cell, 1/24, is not seen
        assert event.place == pytest.approx(middle.tolist(), abs=0.03)


@pytest.mark.parametrize("name", ["growing_ball", "squashed_ball", "rotating_box"])
def test_motions_without_change_have_no_event(name):
    motion, times = MOTIONS[name](3), [0.0, 0.5, 1.0]
    assert topology_events(motion, times, meshes_of(motion, times, 32), 32) == ()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", ["squashed_ball", "squashed_box", "rotating_box", "translating_ball", "growing_ball"])
def test_a_carried_surface_keeps_to_f_and_a_free_one_not_to_its_volume(name, dim):
    motion, times = MOTIONS[name](dim), [0.0, 0.5, 1.0]
    check = carried(motion, times, 40)
    exact = [motion.volume(t) / motion.volume(0.0) for t in times]
    # a linear motion keeps the proportions of volumes of polyhedra exactly, a radial one to the order of their cells
    assert check.volumes == pytest.approx(exact, rel=6e-3 if name == "growing_ball" else 1e-6)
    # both surfaces are polyhedra, and cut edges by less than a cell
    cell = 2 / 40
    assert check.mean_distance < cell / 8
    assert check.maximum_distance < cell


def test_the_drift_of_a_flow_that_bends_a_surface_is_that_of_its_mesh_and_is_told():
    """A shear, x₂ += 0.3 sin(4 x₁) t, keeps all volumes; straight segments follow it only roughly."""
    middle = torch.tensor([0.1, 0.07], dtype=torch.double)

    class Sheared(Still):
        has_velocity = True

        def velocity(self, x, t):
            return torch.stack([0 * x[:, 0], 0.3 * torch.sin(4 * x[:, 0])], 1)

    def field(x, t):
        return Ball(2).jet(torch.stack([x[:, 0], x[:, 1] - 0.3 * t * torch.sin(4 * x[:, 0])], 1) - middle).value

    coarse, fine = (carried(Sheared(2, field), [0.0, 0.5, 1.0], resolution) for resolution in (24, 48))
    for check in (coarse, fine):
        assert check.drift < check.error
    assert coarse.mean_distance < 0.02
    assert fine.error < coarse.error / 2


def test_without_velocity_or_surface_nothing_is_carried():
    morph = Still(2, two_balls)
    assert carried(morph, [0.0, 1.0], 16) is None
    gone = MOTIONS["growing_ball"](2)
    empty = extract_surface(lambda x: x[:, 0] ** 2 + 1, gone.bounds, 8)
    assert check_advection(gone, empty, [0.0], [empty]) is None


@pytest.mark.parametrize("dim", [2, 3])
def test_a_growth_that_is_wanted_is_no_deviation(dim):
    grown = Grown(MOTIONS["squashed_ball"](dim), VolumeLinear(dim, 1.0, 0.5))
    curve = volume_curve(grown, torch.tensor([0.0, 0.5, 1.0]), resolution=48)
    assert curve.volumes[-1] / curve.volumes[0] == pytest.approx(0.5, rel=1e-3)
    assert curve.maximum_deviation < 1e-3
    times = [0.0, 0.5, 1.0]
    check = carried(grown, times, 32)
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


def test_the_protocol_gives_the_known_figures_of_the_authors_morph(data_dir):
    """kitten → fandisk as its authors trained it: volume, distance, normals, ‖∇f‖ and roughness."""

    def layers(path, omega):
        state = torch.load(data_dir / "official" / path, weights_only=True, map_location="cpu")
        tensors = list(state.values())
        return tuple(omega * tensor for tensor in tensors[:-2]) + tuple(tensors[-2:])

    network = layers("morphs/kitten-fandisk/best.pth", 1.0)
    fandisk = layers("ni/fandisk.pth", 60.0)

    class Official(LinearMotion):
        has_velocity = False

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
    halfway = surface_at(morph, 0.5, 96)
    assert halfway.gradient_norm == pytest.approx(0.75, abs=0.01)
    assert (halfway.components, halfway.euler) == (1, 2)
    assert halfway.roughness == pytest.approx(3.0, abs=0.05)


@pytest.mark.parametrize("dim", [2, 3])
def test_all_figures_of_a_perfect_morph(dim):
    stages = []
    morph = MOTIONS["translating_ball"](dim)
    result = evaluate_morph(morph, COARSE, stages.append)
    figures = result.figures()
    assert len(stages) == STAGES
    assert figures["volume max"] < 5e-3
    assert figures["volume estimator error"] < 1e-2
    assert figures["morph to shape t=0"] < 1e-6
    assert figures["normal error t=1"] < 0.1
    assert figures["most components"] == figures["fewest components"] == 1
    assert figures["most handles"] == figures["topology events"] == 0
    assert figures["speed max/mean"] == pytest.approx(1, abs=0.03)
    assert figures["motion in middle half"] == pytest.approx(0.5, abs=0.01)
    assert figures["carried volume drift"] < 1e-9
    nothing = ["eikonal", "level set", "divergence"]
    assert all(figures[f"{name} {where}"] < 1e-4 for name in nothing for where in ("shell", "box"))
    assert all(s.euler == (2 if dim == 3 else 0) for s in result.surfaces)
    again = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert again["figures"] == pytest.approx(figures)
    assert all(find_metric(name).meaning for name in figures)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_volumes_are_told_in_the_units_of_the_file(scale):
    still = Still(3, lambda x, t: x.norm(dim=1) - 0.5)
    # in its file a ball of radius `scale` around (7, 0, 0)
    still.source = shapes.Ball(scale, [7.0, 0, 0]).transformed(Similarity.about(torch.zeros(3), 0.5 / scale))
    result = evaluate_morph(still, Protocol(24, 24, 2))
    volumes, figures = result.to_dict()["volume"], result.figures()
    assert figures["volume t=0"] == pytest.approx(4 / 3 * math.pi * scale**3, rel=1e-2)
    assert volumes["volumes_in_file_units"] == pytest.approx([v * (2 * scale) ** 3 for v in volumes["volumes"]])
    assert f"| volume t=0 | {figures['volume t=0']:.5g} |" in markdown_table({"a": figures})


def test_a_protocol_tells_all_of_itself():
    told = json.loads(json.dumps(COARSE.describe()))
    assert told["volume_resolution"] == 24
    assert told["shell_width"] == 0.05
    assert "RungeKutta" in told["advection"]


def test_a_morph_that_is_gone_is_still_measured():
    """No surface, no velocity: nothing fails, and what is not defined is None in JSON."""
    gone = Nothing(Ball(3))
    gone.source = gone.target = lambda x: Ball(3).jet(x).value
    result = evaluate_morph(gone, Protocol(16, 16, 3))
    told = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    figures = told["figures"]
    for name in ("volume std", "morph to shape t=0", "gradient norm least", "level set box", "speed max/mean"):
        assert figures[name] is None
    assert figures["volume error t=0"] == pytest.approx(-1)
    assert figures["most components"] == figures["area greatest"] == 0
    assert told["advection"] is None
    assert "carried volume drift" not in figures


NEW_FIGURE = """
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import RATIO

FINAL = MorphMetric(
    name="final volume",
    unit=RATIO,
    meaning="volume at t = 1 over that at t = 0",
    section=Section.VOLUME,
    ideal=1.0,
    heading="final volume",
    compute=lambda measured: float(measured.volume.volumes[-1] / measured.volume.volumes[0]),
)
"""


def test_a_file_with_a_figure_is_all_that_tables_and_evaluations_need(tmp_path, monkeypatch):
    (tmp_path / "final_volume.py").write_text(NEW_FIGURE)
    monkeypatch.setattr(figures, "__path__", [*figures.__path__, str(tmp_path)])
    monkeypatch.delitem(sys.modules, f"{figures.__name__}.final_volume", raising=False)
    before = {metric.name for metric in all_metrics()} - {"final volume"}
    assert "volume std" in before
    found = evaluate_morph(MOTIONS["growing_ball"](2), COARSE)
    assert found.figures()["final volume"] == pytest.approx((0.7 / 0.4) ** 2, rel=1e-2)
    assert found.to_dict()["figures"]["final volume"] == found.figures()["final volume"]
    rows = markdown_table({"ours": found.figures()}).splitlines()
    assert f"| final volume | {found.figures()['final volume']:.2f} |" in rows
    assert rows.index(next(row for row in rows if "| final volume" in row)) < rows.index(
        next(row for row in rows if "chamfer" in row)
    ), "beside the other figures of its section"
    outcomes = [Result("a_b", name, 0, figures={"final volume": value}) for name, value in (("x", 1.5), ("y", 0.9))]
    assert "| y | **0.900** |" in markdown(figure_table("final volume", outcomes, ["a_b"], ["x", "y"]))
    assert "| method | final volume |" in markdown(overview("a_b", outcomes, ["x", "y"]))


def test_every_figure_has_a_name_of_its_own_and_describes_itself():
    known = all_metrics()
    assert len({metric.name for metric in known}) == len(known) > 40
    for metric in known:
        assert metric.meaning[:1].islower() or metric.meaning.startswith("|"), metric.name
        assert not metric.meaning.endswith("."), metric.name
        assert metric.unit.name, metric.name
        assert all(find_metric(name) is metric for name in metric.names())
    with pytest.raises(KeyError):
        find_metric("volume mean")


def test_volume_that_leaves_the_box_is_reported_and_not_only_lost() -> None:
    """A ball ends with half of itself outside: the curve loses half of it, and the figure says where it is."""
    leaving = LinearMotion(Ball(2, 0.3), drift=[1.0, 0.0])
    figures = evaluate_morph(leaving, COARSE).figures()
    assert figures["volume max"] == pytest.approx(0.5, abs=0.02)
    assert figures["volume beyond"] == pytest.approx(0.5, abs=0.05)
    staying = LinearMotion(Ball(2, 0.3), drift=[0.5, 0.0])
    assert evaluate_morph(staying, COARSE).figures()["volume beyond"] == 0


def test_roughness_between_the_ends_is_relative_to_the_rougher_end() -> None:
    still = LinearMotion(Ball(2, 0.4))
    figures = evaluate_morph(still, COARSE).figures()
    assert figures["roughness at 1/2"] == pytest.approx(1)
    assert (figures["fewest pieces"], figures["most pieces"]) == (1, 1)

    def rippled(x: torch.Tensor, t: float) -> torch.Tensor:
        angle = torch.atan2(x[:, 1], x[:, 0])
        return x.norm(dim=1) - 0.6 - 0.05 * math.sin(math.pi * t) * torch.cos(12 * angle)

    assert evaluate_morph(Still(2, rippled), COARSE).figures()["roughness at 1/2"] > 1.5
