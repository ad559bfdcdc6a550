"""What cannot work ends with one sentence and status 2, before anything is written."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import trimesh
from runs import BARE, files, train_here

from nsm.losses import Eikonal


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a run, not made yet."""
    monkeypatch.setenv("NSM_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delenv("NSM_DATA_DIR", raising=False)
    return tmp_path / "run"


def refused(capsys: pytest.CaptureFixture[str], folder: Path, *overrides: str) -> str:
    """The sentence that a command ends with; nothing else is said, and nothing written but Hydra's own."""
    assert train_here(*overrides, f"hydra.run.dir={folder}") == 2
    said = capsys.readouterr().err.strip()
    assert "Traceback" not in said
    assert said.count("nsm:") == 1, said
    lines = [line for line in said.splitlines() if line.strip()]
    assert len(lines) == 1, said
    assert said.startswith("nsm: ")
    assert folder.is_file() or not files(folder)
    return said.removeprefix("nsm: ")


def test_a_mesh_that_is_not_there(capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "none.obj"
    assert str(path) in refused(capsys, folder, "shape@source=mesh", f"source.path={path}")


def test_a_mesh_whose_path_was_not_given(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    assert "source.path" in refused(capsys, folder, "shape@source=mesh")


def test_a_folder_in_place_of_a_mesh(capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path) -> None:
    assert str(tmp_path) in refused(capsys, folder, "shape@source=mesh", f"source.path={tmp_path}")


@pytest.mark.parametrize("part", [0.0, 0.5])
def test_a_mesh_that_is_empty_or_cut(
    part: float, capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    path = tmp_path / "cut.ply"
    whole = trimesh.creation.icosphere(1).export(file_type="ply")
    path.write_bytes(whole[: int(part * len(whole))])
    assert str(path) in refused(capsys, folder, "shape@source=mesh", f"source.path={path}")


def test_shapes_of_two_dimensions(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    sentence = refused(capsys, folder, "shape@source=disk", "shape@target=ball")
    assert "must have the dimension of the source, 2D, got a shape in 3D." in sentence
    assert "Try `shape@target=square`." in sentence


@pytest.mark.parametrize("override", ["source.radius=0", "source.radius=-1"])
def test_a_shape_without_volume(override: str, capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    assert "radius" in refused(capsys, folder, *BARE, override)


@pytest.mark.parametrize("override", ["stepps=3", "sampler.sizes=3", "velocity.gamma=1", "loss.terms.eikonal.wait=1"])
def test_an_unknown_key(override: str, capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    assert override.partition("=")[0].rpartition(".")[2] in refused(capsys, folder, override)
    assert not folder.exists()


@pytest.mark.parametrize(
    "override", ["method=magic", "velocity=magic", "shape@source=magic", "+experiment=magic", "task=magic"]
)
def test_an_unknown_choice(override: str, capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    sentence = refused(capsys, folder, override)
    assert f"`{override.partition('=')[0]}` must be one of " in sentence
    assert "got magic" in sentence
    assert not folder.exists()


def test_a_folder_that_cannot_be_written(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    obstacle = tmp_path / "file"
    obstacle.write_text("in the way")
    below = obstacle / "run"
    assert train_here(*BARE, f"hydra.run.dir={below}") == 2
    said = capsys.readouterr().err.strip()
    assert str(obstacle) in said
    assert "Try another folder with `hydra.run.dir=FOLDER`." in said
    assert len(said.splitlines()) == 1
    assert obstacle.read_text() == "in the way"


@pytest.mark.parametrize(
    "override", ["steps=0", "steps=-1", "validations=0", "sampler.size=0", "steps=many", "steps=1.5"]
)
def test_a_number_of_nothing(override: str, capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    name = override.partition("=")[0]
    assert refused(capsys, folder, *BARE, override).startswith(f"`{name}` must be a positive integer, got ")


def test_a_task_that_is_none(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    sentence = refused(capsys, folder, "task.kind=paint")
    assert sentence == "`task.kind` must be one of morph, sdf, ot, got paint. Try `task.kind=morph`."


@pytest.mark.parametrize(
    ("override", "word"),
    [
        ("beta.alpha=-1", "beta.alpha"),
        ("sampler.fractions.surface=0.9", "sampler.fractions"),
        ("sampler.box.half_width=0.1", "sampler.box.half_width"),
        ("sampler.time.start=2", "sampler.time"),
        ("network.field.hidden_features=24", "sdf.network"),
        ("network.field.omega=[1,2,3]", "omega"),
    ],
)
def test_a_value_that_makes_no_sense(
    override: str, word: str, capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    extra = ["sdf.network.hidden_features=16"] if word == "sdf.network" else []
    assert train_here(*BARE, override, *extra, f"hydra.run.dir={folder}") == 2
    assert word in capsys.readouterr().err
    assert not files(folder)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("method=lipmlp", "got task=morph and velocity=none"),
        ("method=ot", "got task=ot and velocity=none"),
        ("task=sdf", "got task=sdf and velocity=adadiv"),
    ],
)
def test_landmarks_that_nothing_carries(
    override: str, words: str, capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    sentence = refused(capsys, folder, override, "landmarks=table", "landmarks.path=a.csv")
    assert f"`landmarks` must come with a morph whose velocity carries them, {words}." in sentence


@pytest.mark.parametrize(("override", "task"), [("method=ot", "ot"), ("task=sdf", "sdf")])
def test_a_symmetry_of_nothing_that_is_trained(
    override: str, task: str, capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    sentence = refused(capsys, folder, override, "symmetry=x")
    assert f"`symmetry` must come with a morph that is trained, got task={task}." in sentence


def test_landmarks_that_are_not_there(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    sentence = refused(capsys, folder, *BARE, "landmarks=table", "landmarks.path=none.csv")
    assert "`landmarks.path` must be a readable CSV file, got none.csv" in sentence


def test_a_fit_that_collapses(
    capsys: pytest.CaptureFixture[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Eikonal, "residual", lambda self, evaluation: evaluation.slope * math.inf)
    assert train_here(*BARE, f"hydra.run.dir={folder}") == 2
    said = capsys.readouterr().err
    assert "nsm: The fit of a network to the ball must succeed, got two failures (the loss eikonal" in said
    assert "Traceback" not in said
    assert not files(folder)


def test_a_morph_given_as_a_shape(capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "morph"
    assert train_here(*BARE, "steps=1", "validations=1", f"hydra.run.dir={other}") == 0
    capsys.readouterr()
    sentence = refused(capsys, folder, "shape@source=fitted", f"source.path={other}")
    assert "it must be the checkpoint of a run with `task=sdf`, got a NeuralMorph. Try another run." in sentence
