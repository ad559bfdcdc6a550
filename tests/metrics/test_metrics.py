"""All figures of merit of morphs whose figures are known."""

from __future__ import annotations

import json
import math
import sys
from functools import partial

import pytest
import torch
from measured import COARSE, Nothing, Still, surface_at
from problems import MOTIONS, Ball, LinearMotion

from nsm import calculus, shapes
from nsm.compare.results import Result
from nsm.compare.tabulate import figure_table, overview
from nsm.evaluate.tables import markdown_table
from nsm.geometry.differences import finite_gradient
from nsm.metrics import AT, Protocol, all_metrics, evaluate_morph, figures, find_metric, stages, volume_curve
from nsm.metrics.endpoint import endpoint_errors
from nsm.plots.tables import markdown
from nsm.shapes import Similarity
from nsm.types import Morph


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
    begun = []
    morph = MOTIONS["translating_ball"](dim)
    result = evaluate_morph(morph, COARSE, begun.append)
    figures = result.figures()
    assert len(begun) == stages(morph)
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


NEW_FIGURE = '''
from nsm.metrics import Measurements, MorphMetric, Section
from nsm.metrics.unit import RATIO


@MorphMetric.define("final volume", RATIO, Section.VOLUME, ideal=1.0, heading="final volume")
def final(measured: Measurements) -> float:
    """Volume at t = 1 over that at t = 0."""
    return float(measured.volume.volumes[-1] / measured.volume.volumes[0])
'''


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
        assert metric.meaning != metric.name
        assert "\n" not in metric.meaning, metric.name
        assert metric.unit.name, metric.name
        rows = [f"{metric.name}{AT}{time}" for time in (0, 0.4, 1)]
        assert metric.rows(reversed(["volume of nothing", *rows])) == rows
        assert all(find_metric(name) is metric for name in [metric.name, *rows])
    with pytest.raises(KeyError):
        find_metric("volume mean")
