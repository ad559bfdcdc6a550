"""Frames and pictures at the times of a film."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from analytic import run_here, save, shrinking
from folders import read_mesh

import nsm
from nsm.export import __main__ as export
from nsm.io.loading import load_morphs, retimed
from nsm.render import __main__ as render


@pytest.fixture(autouse=True)
def _somewhere_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    save(shrinking(3, 0.2), tmp_path / "a.ckpt")


def test_frames_show_the_morph_at_the_times_that_the_timing_maps_them_to() -> None:
    common = ("checkpoint=a.ckpt", "resolution=12", "ends=network")
    assert run_here(export, *common, "times=[0,0.25,1]", "timing=smooth", "output=eased") == 0
    assert run_here(export, *common, "times=[0,0.15625,1]", "output=plain") == 0
    for number in range(3):
        eased, plain = (read_mesh(Path(folder) / f"frame_{number:04d}.ply") for folder in ("eased", "plain"))
        np.testing.assert_allclose(eased.vertices, plain.vertices, atol=1e-6)
    settings = json.loads(Path("eased/frames.json").read_text())["settings"]
    assert settings["timing"]["_target_"].endswith("Smooth")


def test_an_export_does_not_go_on_with_the_frames_of_another_timing(capsys: pytest.CaptureFixture[str]) -> None:
    common = ("checkpoint=a.ckpt", "resolution=12", "times=2", "output=frames")
    assert run_here(export, *common) == 0
    assert run_here(export, *common, "timing=ease_in") == 2
    assert "whose frames have timing=" in " ".join(capsys.readouterr().err.split())


def test_programs_have_the_time_of_the_morph(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_here(export, "checkpoint=a.ckpt", "format=safetensors", "timing=smooth") == 2
    assert "`timing` must be linear for a format that holds the networks" in " ".join(capsys.readouterr().err.split())


def test_a_table_needs_its_pairs(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_here(render, "checkpoint=a.ckpt", "timing=table") == 2
    assert "`timing.pairs` must be pairs of times from [0,0] to [1,1]" in " ".join(capsys.readouterr().err.split())
    table = {"_target_": "nsm.morphs.timing.Table", "pairs": [[0, 0], [0.5, 0.1], [1, 1]]}
    config = {"checkpoint": "a.ckpt", "official": None, "growth": None, "ends": "network"}
    loaded = load_morphs(config, "nsm.render")
    (film,) = retimed(loaded, table)
    x = torch.rand(5, 3)
    torch.testing.assert_close(film.morph(x, 0.5), loaded[0].morph(x, 0.1))


def test_a_saved_film_follows_a_timing() -> None:
    morph = nsm.load_morph("a.ckpt")
    folder = morph.save("meshes", frames=3, resolution=12, timing=[[0, 0], [0.5, 0.2], [1, 1]])
    expected = morph.mesh(0.2, resolution=12)
    np.testing.assert_allclose(read_mesh(folder / "frame_0001.ply").vertices, expected.vertices, atol=1e-6)
