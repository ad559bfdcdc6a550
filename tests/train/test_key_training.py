"""Training through more than two shapes."""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import pytest
import torch
from runs import BARE, train_here

from nsm import load_morph
from nsm.cli.errors import InputError
from nsm.evaluate.tables import markdown_table
from nsm.fields import ScalarSiren
from nsm.metrics import Protocol, evaluate_morph
from nsm.morphs.neural import NeuralMorph
from nsm.sampling import Box as TrainingBox
from nsm.sampling import Fractions, MorphSampler, UniformTime
from nsm.shapes import Ball, Box, Cylinder, Torus, Union
from nsm.train.consistency import effective
from nsm.train.tasks import SdfFit, draw_pools, prepare_keys
from nsm.train.tasks.validation import Validator

NO_FIT = mock.Mock(spec=SdfFit)
THREE = (*BARE, "+shape@between.a=square", "+shape@between.b=disk", "times=[0,0.25,0.5,1]")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    assert train_here(*THREE, f"hydra.run.dir={folder}") == 0
    return folder


def test_a_checkpoint_restores_all_keys(run: Path) -> None:
    morph = load_morph(run)
    assert [key.time for key in morph.keys] == [0, 0.25, 0.5, 1]
    assert [origin["kind"] for origin in morph.provenance["between"]] == ["box", "ball"]
    x = 2 * torch.rand(50, 2) - 1
    for key in morph.keys:
        torch.testing.assert_close(morph(x, key.time), key.shape(x))
    areas = [key.shape.volume() for key in morph.keys]
    assert areas == pytest.approx([min(areas)] * 4, rel=1e-6)


def test_evaluation_reports_every_key(run: Path) -> None:
    figures = evaluate_morph(load_morph(run), Protocol(24, 24, times=3)).figures()
    rows = [name for name in figures if name.startswith("chamfer")]
    assert rows == ["chamfer t=0", "chamfer t=0.25", "chamfer t=0.5", "chamfer t=1"]
    assert max(figures[row] for row in rows) < 1e-6
    shown = [line.split("|")[1].strip() for line in markdown_table({"a": figures}).splitlines()]
    assert [name for name in shown if name.startswith("chamfer")] == rows


def test_validation_measures_at_every_key(run: Path) -> None:
    morph = load_morph(run, ends="network").network
    validator = Validator(morph, 1.5, 16, 3)
    assert validator.times.tolist() == [0, 0.25, 0.5, 1]
    assert [validator.times[number] for number in validator.at_keys] == [0, 0.25, 0.5, 1]


def test_a_morph_may_have_as_many_pieces_as_the_shapes_before_and_after() -> None:
    two = Union([Ball(0.2, [-0.5, 0, 0]), Ball(0.2, [0.5, 0, 0])])
    morph = NeuralMorph(ScalarSiren(4, 8, 1), None, Ball(0.5), Ball(0.4), between=[two], times=[0, 0.4, 1])
    validator = Validator(morph.requires_grad_(False), 1.5, 32, 6)
    assert validator._expected() == [1, 2, 2, 2, 2, 1]


def test_a_batch_holds_as_many_points_of_each_key() -> None:
    shapes = {0.0: Ball(0.5), 0.4: Box([0.5, 0.5, 0.5]), 1.0: Ball(0.3)}
    pools = {time: draw_pools(shape, 200, seed=0) for time, shape in shapes.items()}
    batch = MorphSampler(pools, TrainingBox(3), UniformTime(), 80, Fractions()).draw(torch.Generator().manual_seed(0))
    for part, counts in ((batch.surface, [7, 7, 6]), (batch.ambient, [7, 7, 6])):
        x, times = batch.points[part, :3], batch.points[part, 3]
        assert [(times == torch.tensor(time)).sum().item() for time in shapes] == counts
        for time, shape in shapes.items():
            here = times == torch.tensor(time)
            torch.testing.assert_close(shape(x[here]), batch.distances[part][here], atol=1e-6, rtol=0)


def test_three_shapes_fill_the_box_at_one_volume() -> None:
    pair = Union([Cylinder(0.2, 0.5, [c, 0, 0]) for c in (-0.5, 0.5)])
    prepared = prepare_keys([pair, Ball(0.7), Torus(0.4, 0.1)], NO_FIT, times=[0, 0.7, 1])
    volumes = [key.shape.volume() for key in prepared.keys]
    assert volumes == pytest.approx([volumes[0]] * 3, rel=1e-9)
    boxes = torch.stack([key.shape.exact_bounds() for key in prepared.keys])
    assert float((boxes[:, 1].amax(0) - boxes[:, 0].amin(0)).max()) == pytest.approx(1.8)
    assert prepared.provenance["between"][0]["scale"] < 1


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        (["times=[0,0.5,1]"], "`times` must be 4 times from 0 to 1, one for each shape, got [0, 0.5, 1]."),
        (["method=nise"], "`between` must be empty for a velocity that leads straight to the target, got 2 shapes"),
        (["method=ot"], "`between` must be empty for optimal transport"),
        (["+shape@between.c=ball"], "`shape@target` must have the dimension of the source, 2D"),
    ],
)
def test_what_cannot_pass_keys_is_refused(
    overrides: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = [o for o in THREE if not o.startswith("times=")]
    if overrides == ["method=ot"]:  # which refuses settings of training before
        chosen = effective(chosen, "ot")
    assert train_here(*chosen, *overrides, f"hydra.run.dir={tmp_path}") == 2
    assert sentence in capsys.readouterr().err


def test_shapes_of_different_dimensions_are_refused() -> None:
    with pytest.raises(InputError, match=r"must have the dimension of the source, 3D, got a shape in 2D"):
        prepare_keys([Ball(0.5), Ball(0.5, [0, 0]), Ball(0.4)], NO_FIT)
