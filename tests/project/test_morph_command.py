"""``nsm morph``: two files in, a file or a folder out, in one line."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from test_library import TINY

import nsm.__main__ as program
from nsm.io.checkpoint import read_checkpoint
from nsm.library import command, load_morph, morph


@pytest.fixture
def meshes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, str]:
    """A ball and a box in the current folder; training is so short that it takes seconds."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NSM_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(command, "morph", partial(morph, steps=4, **TINY))
    trimesh.creation.icosphere(subdivisions=2).export("ball.obj")
    trimesh.creation.box((2, 1.6, 1.6)).export("box.ply")
    return "ball.obj", "box.ply"


def run(monkeypatch: pytest.MonkeyPatch, *typed: str) -> int:
    """The exit status of ``nsm morph``."""
    monkeypatch.setattr(sys, "argv", ["nsm", "morph", *typed])
    try:
        program.main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_one_line_writes_an_animation_and_keeps_the_run(
    meshes: tuple[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("pairs.csv").write_text("1,0,0,1,0,0\n")
    typed = (*meshes, "-o", "out/morph.glb", "--frames", "3", "--resolution", "16", "--keep", "run", "--align", "rigid")
    typed += ("--landmarks", "pairs.csv", "--symmetry", "y", "--timing", "smooth")
    assert run(monkeypatch, *typed) == 0
    assert "wrote out/morph.glb" in capsys.readouterr().out
    assert trimesh.load("out/morph.glb").geometry
    assert load_morph("run").provenance["target"]["alignment"]["kind"] == "rigid"
    assert load_morph("run").provenance["landmarks"]["source"] == [[1, 0, 0]]
    # what was kept is a shape of its own for the next command: a morph is refused by name
    assert run(monkeypatch, "run", meshes[1]) == 2
    assert "must be the checkpoint of a run with `task=sdf`, got a NeuralMorph" in capsys.readouterr().err


def test_by_default_a_folder_named_after_both_holds_the_meshes(
    meshes: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run(monkeypatch, *meshes, "--frames", "3", "--resolution", "16") == 0
    assert len(list(Path("ball_box").glob("*.ply"))) == 3


def test_a_morph_may_pass_through_shapes_between(meshes: tuple[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    typed = ("ball.obj", "box.ply", "ball.obj", "box.ply", "--times", "0,0.2,0.6,1", "--between-setting", "up=[0,0,1]")
    assert run(monkeypatch, *typed, "-o", "strip.png", "--frames", "2", "--resolution", "16", "--keep", "run") == 0
    morph = load_morph("run")
    assert [key.time for key in morph.keys] == [0, 0.2, 0.6, 1]
    assert [Path(origin["path"]).name for origin in morph.provenance["between"]] == ["box.ply", "ball.obj"]


@pytest.mark.parametrize(
    ("typed", "sentence"),
    [
        (["-o", "film.mp5"], "got film.mp5. Try `--output film.mp4`."),
        (["--budget", "ful"], "`budget` must be one of fast, full, plane, got ful. Try `budget=full`."),
        (
            ["--align", "ridgid"],
            "`align` must be one of none, rigid, shared, similarity, got ridgid. Try `align=rigid`.",
        ),
        (["--symmetry", "w"], "`symmetry` must be one of none, x, y, z, got w."),
        (["--timing", "smoth"], "`timing` must be one of ease_in, ease_out, linear, smooth, got smoth."),
        (["--frames", "0"], "`frames` must be an integer of at least 2, got 0."),
        (["--times", "0,x"], "`--times` must be numbers with commas between, got 0,x. Try `--times 0,0.4,1`."),
        (["--fames", "3"], "Try `nsm morph a.obj b.obj -o film.mp4`."),
    ],
)
def test_a_mistake_is_refused_before_training(
    typed: list[str],
    sentence: str,
    meshes: tuple[str, str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(command, "morph", None)
    assert run(monkeypatch, *meshes, *typed) == 2
    assert sentence in capsys.readouterr().err


def test_a_missing_file_is_named(
    meshes: tuple[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "none.obj", meshes[1]) == 2
    assert "none.obj" in capsys.readouterr().err


def test_settings_of_a_shape_pick_a_label(
    meshes: tuple[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    nibabel = pytest.importorskip("nibabel")
    labels = np.zeros((20, 20, 20), dtype=np.uint8)
    labels[4:16, 4:16, 4:10], labels[4:16, 4:16, 10:16] = 1, 2
    nibabel.save(nibabel.Nifti1Image(labels, np.eye(4)), "scan.nii.gz")
    kept = ("-o", "morph.ckpt", "--keep", "run", "--target-setting", "pose.rotation=[0,0,90]")
    assert run(monkeypatch, "scan.nii.gz", meshes[1], *kept) == 2
    assert "`label` must be one of 1, 2 in" in capsys.readouterr().err
    assert run(monkeypatch, "scan.nii.gz", meshes[1], *kept, "--source-setting", "label=[1,2]") == 0
    assert read_checkpoint(Path("run/checkpoints/best.ckpt"))["nsm"]["provenance"]["source"]["label"] == [1, 2]
    assert run(monkeypatch, *meshes, "--source-setting", "lable=1") == 2
    assert "Try `label`." in capsys.readouterr().err
    assert run(monkeypatch, *meshes, "--source-setting", "label") == 2
    assert "must have the form NAME=VALUE, got label" in capsys.readouterr().err


def test_help_needs_no_word_of_hydra(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(monkeypatch, "--help") == 0
    said = capsys.readouterr().out
    assert "--budget" in said
    assert "ydra" not in said
