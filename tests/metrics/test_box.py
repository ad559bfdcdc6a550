"""A box that is no cube and lies off the origin, as validation puts one around a moving shape, serves everywhere."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from analytic import run_here, save, shrinking

from nsm.export import __main__ as export
from nsm.io.checkpoint import load_morph
from nsm.metrics import Protocol, evaluate_morph, volume_curve
from nsm.morphs.growth import Grown, VolumeLinear
from nsm.render import __main__ as render

#: Around a ball of radius 0.7, with little room to spare.
BOX = {2: [[-0.85, -0.95], [1.2, 0.8]], 3: [[-0.85, -0.95, -0.8], [1.2, 0.85, 0.9]]}


@pytest.fixture
def file(tmp_path: Path, dim: int) -> Path:
    """A checkpoint that carries such a box."""
    morph = shrinking(dim, 0.1)
    morph.enclose(torch.tensor(BOX[dim]))
    return save(morph, tmp_path / "run" / "checkpoints" / "best.ckpt")


@pytest.mark.parametrize("dim", [2, 3])
def test_a_checkpoint_keeps_the_box_and_volumes_do_not_depend_on_it(file: Path, dim: int) -> None:
    morph = load_morph(file)
    torch.testing.assert_close(morph.bounds, torch.tensor(BOX[dim]))
    curves = [volume_curve(m, torch.tensor([0.0, 1.0]), 64).volumes for m in (morph, shrinking(dim, 0.1))]
    torch.testing.assert_close(curves[0], curves[1], rtol=1e-3, atol=0)
    assert morph.networks().description["bounds"] == morph.bounds.tolist()
    grown = Grown(morph, VolumeLinear(dim, source=1.0, target=2.0))
    volumes = volume_curve(grown, torch.tensor([0.0, 1.0]), 64).volumes
    assert float(volumes[1] / volumes[0]) == pytest.approx(2 * float(curves[0][1] / curves[0][0]), rel=1e-2)


@pytest.mark.parametrize("dim", [2, 3])
def test_figures_meshes_and_pictures_take_such_a_box(file: Path, dim: int, tmp_path: Path) -> None:
    figures = evaluate_morph(load_morph(file), Protocol(volume_resolution=16, surface_resolution=16, times=3)).figures()
    assert figures["volume beyond"] == 0
    assert figures["most pieces"] == 1
    settings = ("times=2", "resolution=24", "exact_volume=true", f"format={'ply' if dim == 3 else 'obj'}")
    assert run_here(export, f"checkpoint={file}", f"output={tmp_path}/frames", *settings) == 0
    for kind in ("slices", "strip"):
        picture = tmp_path / f"{kind}.png"
        fine = ("resolution=24", "times=2") if kind == "slices" else ("size=24", "times=2")
        assert run_here(render, f"checkpoint={file}", f"kind={kind}", *fine, f"output={picture}") == 0
        assert picture.stat().st_size > 0
