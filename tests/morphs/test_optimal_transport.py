"""Morphs by optimal transport against closed forms, and the run that computes one."""

from __future__ import annotations

import json
import math
from copy import deepcopy
from functools import partial
from pathlib import Path

import pytest
import torch
from analytic import run_here, sentence
from runs import files, train_here

from nsm.cli.errors import InputError
from nsm.evaluate import __main__ as evaluate
from nsm.geometry.grid import Lattice
from nsm.geometry.grid import evaluate as values_on
from nsm.geometry.volume import volume
from nsm.io.checkpoint import load_morph
from nsm.metrics import even_times, volume_curve
from nsm.metrics.endpoint import endpoint_errors
from nsm.morphs.optimal_transport.density import REACH
from nsm.morphs.optimal_transport.morph import TransportMorph
from nsm.morphs.optimal_transport.solver import OptimalTransport
from nsm.shapes import Ball
from nsm.types import Morph

#: So few points that all is quick, and a kernel wide enough for them.
SMALL = OptimalTransport(points=6000, anchors=300, blur=0.1, scaling=0.7, kernel=0.07, resolution=32)
#: The same on the command line, from one disk to another.
RUN = (
    "method=ot",
    "+experiment=disk_translation",
    "task.transport.points=4000",
    "task.transport.anchors=200",
    "task.transport.blur=0.1",
    "task.transport.kernel=0.06",
    "task.transport.resolution=40",
    "task.volume_resolution=24",
    "task.volume_times=3",
    "callbacks=none",
    "threads=1",
)


def ball_morph(dim: int) -> TransportMorph:
    """From one ball to the same ball elsewhere."""
    return SMALL.morph(Ball(0.4, [-0.4, 0.1, 0.0][:dim]), Ball(0.4, [0.4, -0.1, 0.2][:dim]), seed=0)


@pytest.fixture(scope="module", params=[2, 3])
def morph(request: pytest.FixtureRequest) -> TransportMorph:
    return ball_morph(request.param)


def test_a_morph_is_a_morph_without_velocity(morph: TransportMorph) -> None:
    assert isinstance(morph, Morph)
    assert morph.velocity(torch.zeros(1, morph.dim), 0.5) is None
    assert not list(morph.parameters())


def test_mass_is_one_at_all_times(morph: TransportMorph) -> None:
    for t in even_times(5).tolist():
        assert float(morph.mass(t).double().sum()) == pytest.approx(1, abs=1e-5)


def test_the_volume_at_the_start_is_that_of_the_source_and_stays(morph: TransportMorph) -> None:
    ball = math.pi ** (morph.dim / 2) / math.gamma(morph.dim / 2 + 1) * 0.4**morph.dim
    curve = volume_curve(morph, even_times(3), 48)
    assert float(curve.volumes[0]) == pytest.approx(ball, rel=1e-2)
    assert curve.maximum_deviation < 0.02


def test_half_way_a_translated_ball_is_in_the_middle(morph: TransportMorph) -> None:
    middle = Ball(0.4, [0.0, 0.0, 0.1][: morph.dim])
    errors = endpoint_errors(morph, 0.5, middle, 48, 48)
    assert errors.morph_to_shape.mean < 0.006
    assert errors.shape_to_morph.mean < 0.006
    assert errors.normal_error < 6
    ends = [endpoint_errors(morph, t, end, 48, 48) for t, end in ((0.0, morph.source), (1.0, morph.target))]
    assert all(end.morph_to_shape.mean < 0.006 for end in ends)


def test_f_is_a_distance_near_the_surface_and_constant_beyond_the_kernel(morph: TransportMorph) -> None:
    direction = torch.nn.functional.normalize(torch.randn(200, morph.dim), dim=1)
    center = torch.tensor([-0.4, 0.1, 0.0])[: morph.dim]
    for distance in (-0.05, 0.0, 0.05):
        x = center + (0.4 + distance) * direction
        f = morph(x, 0.0)
        assert float(f.mean()) == pytest.approx(distance, abs=0.012)
        gradient = morph.gradient(x, 0.0)
        assert float((gradient * direction).sum(1).mean()) == pytest.approx(1, abs=0.15)
    far = torch.full((1, morph.dim), 0.99)
    assert float(morph(far, 0.0) + morph.offset) == pytest.approx(REACH * morph.kernel, rel=1e-3)
    assert float(morph(center[None], 0.0)) < -0.07


def test_the_gradient_is_the_difference_of_f(morph: TransportMorph) -> None:
    x, step = torch.rand(50, morph.dim) * 0.6 - 0.7, float(morph.lattice.step.min())
    along = torch.zeros(morph.dim)
    along[0] = step
    difference = (morph(x + along, 0.3) - morph(x - along, 0.3)) / (2 * step)
    torch.testing.assert_close(morph.gradient(x, 0.3)[:, 0], difference)


def test_every_point_may_have_its_own_time(morph: TransportMorph) -> None:
    x, times = torch.rand(9, morph.dim) - 0.5, torch.tensor([0.0, 0.5, 1.0]).repeat(3)
    values, gradients = morph(x, times), morph.gradient(x, times)
    for t in (0.0, 0.5, 1.0):
        torch.testing.assert_close(values[times == t], morph(x, t)[times == t])
        torch.testing.assert_close(gradients[times == t], morph.gradient(x, t)[times == t])
    assert morph(x[:0], times[:0]).shape == (0,)
    with pytest.raises(ValueError, match="`x` must have shape"):
        morph(x[:, :1], 0.5)


def test_volumes_sampled_near_the_surface_are_those_of_the_whole_grid(morph: TransportMorph) -> None:
    field = partial(morph, t=0.4)
    lattice = Lattice.centers(morph.bounds, 40)
    index = torch.stack(torch.meshgrid(*(torch.arange(n) for n in lattice.shape), indexing="ij"), -1)
    inside = (values_on(field, lattice.points(index.view(-1, morph.dim))) < 0).float().mean() * 2**morph.dim
    assert volume(field, morph.bounds, 40) == pytest.approx(float(inside), rel=0.02)


def test_shapes_of_different_volume_are_reached_as_well() -> None:
    small, large = Ball(0.3, [-0.2, 0.0]), Ball(0.6, [0.1, 0.0])
    curve = volume_curve(SMALL.morph(small, large, seed=0), even_times(3), 48)
    expected = torch.tensor([math.pi * r**2 for r in (0.3, 0.45, 0.6)], dtype=torch.double)
    torch.testing.assert_close(curve.volumes, expected, atol=0, rtol=0.03)


def test_a_copy_and_what_it_is_loaded_with_are_its_own() -> None:
    first, x = ball_morph(2), torch.rand(20, 2) - 0.5
    before = first(x, 0.5)
    other = deepcopy(first)
    state = {name: -value if name in ("starts", "stops") else value for name, value in first.state_dict().items()}
    other.load_state_dict(state)
    torch.testing.assert_close(other(-x, 0.5), before, atol=1e-5, rtol=0)
    assert torch.equal(first(x, 0.5), before)


def test_a_volume_that_no_threshold_gives_is_refused() -> None:
    ball = Ball(0.3, [0.0, 0.0])
    with pytest.raises(InputError, match="narrow enough to show the volume 100 of the source"):
        TransportMorph(ball, ball, 10, 0.1, 32, [100.0, 100.0]).calibrate()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ot") / "run"
    assert train_here(*RUN, f"hydra.run.dir={folder}") == 0
    return folder


def test_a_run_writes_what_a_run_does_and_loads_bit_for_bit(finished: Path, tmp_path: Path) -> None:
    assert files(finished) == {
        "checkpoints/best.ckpt",
        "checkpoints/last.ckpt",
        "log/metrics.csv",
        "summary.json",
    }
    summary = json.loads((finished / "summary.json").read_text())
    assert summary["steps"] == 0
    assert summary["val/volume_max"] < 0.02
    assert summary["val/volume_error"] < 0.02
    assert train_here(*RUN, f"hydra.run.dir={tmp_path}") == 0
    ours, again = load_morph(finished), load_morph(tmp_path / "checkpoints" / "last.ckpt")
    x = torch.rand(100, 2) * 2 - 1
    assert isinstance(ours, TransportMorph)
    assert torch.equal(ours(x, 0.5), again(x, 0.5))
    assert float(ours(torch.tensor([[0.0, 0.0]]), 0.5)) < 0
    scale = 0.9 / 0.8  # the disks reach from -0.8 to 0.8, and fill the box to 0.9
    torch.testing.assert_close(ours.source(x), (x - scale * torch.tensor([-0.5, 0.0])).norm(dim=1) - scale * 0.3)


def test_a_run_may_have_meshes_and_a_strip(tmp_path: Path) -> None:
    run = [o for o in RUN if o != "callbacks=none"]
    small = ["callbacks.meshes.resolution=12", "callbacks.meshes.times=[0.5]", "callbacks.strip.size=24"]
    assert train_here(*run, *small, f"hydra.run.dir={tmp_path}") == 0
    assert {"meshes/best/t_0.500.obj", "strip.png", "volume.csv", "volume.png"} <= files(tmp_path)


def test_a_finished_run_is_not_made_again(finished: Path, capfd: pytest.CaptureFixture[str]) -> None:
    before = (finished / "checkpoints" / "last.ckpt").stat().st_mtime_ns
    assert train_here(*RUN, "resume=true", f"hydra.run.dir={finished}") == 0
    assert (finished / "checkpoints" / "last.ckpt").stat().st_mtime_ns == before
    assert "has already finished; optimal transport has no steps" in (finished / "train.log").read_text()
    assert train_here(*RUN, "resume=true", "seed=1", f"hydra.run.dir={finished}") == 2
    assert "got another sdf.seed, seed. Try the command that started the run" in sentence(capfd.readouterr().err)


def test_a_run_is_evaluated_like_any_other(finished: Path, tmp_path: Path) -> None:
    tiny = ("volume_resolution=16", "surface_resolution=16", "times=3", "samples=500", "picture_size=24")
    assert run_here(evaluate, f"checkpoint={finished}", *tiny, f"output={tmp_path}", f"hydra.run.dir={tmp_path}") == 0
    assert (tmp_path / "metrics.json").is_file()


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("points=0", "`task.transport.points` must be a positive integer, got 0"),
        ("anchors=9999999", "`task.transport.anchors` must be at most `task.transport.points`, 4000, got 9999999"),
        ("blur=0", "`task.transport.blur` must be a number between 0 and 1, got 0"),
        ("scaling=1.0", "`task.transport.scaling` must be a number between 0 and 1, got 1.0"),
        ("kernel=0.001", "must be at least the width of a cell"),
    ],
)
def test_bad_settings_are_told_in_a_sentence(
    override: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert train_here(*RUN, f"task.transport.{override}", f"hydra.run.dir={tmp_path}") == 2
    assert words in sentence(capsys.readouterr().err)
    assert not (tmp_path / "checkpoints").exists()
