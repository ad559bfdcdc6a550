"""Checkpoints: the same field comes back, and files that are not checkpoints of nsm have no effect."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import torch
from omegaconf import OmegaConf
from runs import STILL, train_here

import nsm
from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.fields import AdaDiv, Gaussian, ScalarSiren, VectorSiren
from nsm.io import checkpoint
from nsm.io.build import build
from nsm.io.checkpoint import FORMAT, load_morph, read_checkpoint
from nsm.morphs.neural import NeuralMorph
from nsm.shapes import Ball
from nsm.shapes.torch_files import load_torch

MODEL: dict[str, Any] = {
    "_target_": "nsm.morphs.neural.NeuralMorph",
    "field": {"_target_": "nsm.fields.ScalarSiren", "in_features": 3, "hidden_features": 8, "hidden_layers": 2},
    "velocity": {
        "_target_": "nsm.fields.AdaDiv",
        "dim": 2,
        "network": {
            "_target_": "nsm.fields.VectorSiren",
            "_partial_": True,
            "hidden_features": 8,
            "hidden_layers": 2,
            "omega": 5.0,
        },
        "beta": {"_target_": "nsm.fields.Gaussian", "alpha": 0.3},
    },
    "source": Ball(0.3, [0.0, 0.0]).config(),
    "target": Ball(0.4, [0.1, 0.0]).config(),
}


def save(content: Any, file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    torch.save(content, file)


def content(**changes: Any) -> dict[str, Any]:
    """What a checkpoint of a small morph holds."""
    state = {f"morph.{key}": value for key, value in build(MODEL).state_dict().items()}
    entry = {"format": FORMAT, "version": nsm.__version__, "model": MODEL, "config": {}, "provenance": {}}
    return {"state_dict": state, "nsm": {**entry, **changes}}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a.ckpt"
    save(content(), path)
    return path


def test_a_morph_is_built_as_described(file: Path) -> None:
    morph = load_morph(file)
    assert isinstance(morph, NeuralMorph)
    assert isinstance(morph.field, ScalarSiren)
    assert isinstance(morph.velocity_field, AdaDiv)
    assert isinstance(morph.velocity_field.network, VectorSiren)
    assert isinstance(morph.velocity_field.beta, Gaussian)
    assert morph.velocity_field.beta.alpha == 0.3
    assert morph.dim == 2
    assert not morph.training
    assert not any(p.requires_grad for p in morph.parameters())


def test_a_loaded_morph_is_bitwise_the_one_saved(file: Path) -> None:
    saved, morph = torch.load(file, weights_only=True)["state_dict"], load_morph(file)
    assert {f"morph.{key}" for key in morph.state_dict()} == set(saved)
    assert all(torch.equal(value, saved[f"morph.{key}"]) for key, value in morph.state_dict().items())


def test_the_interface_of_a_morph(file: Path) -> None:
    morph, x = load_morph(str(file)), torch.rand(7, 2) * 2 - 1
    times = torch.full((7,), 0.3)
    assert morph(x, 0.3).shape == (7,)
    assert torch.equal(morph(x, 0.3), morph(x, times))
    assert morph.gradient(x, 0.3).shape == (7, 2)
    velocity = morph.velocity(x, times)
    assert velocity is not None
    assert velocity.shape == (7, 2)
    assert torch.equal(morph.bounds, torch.tensor([[-1.0, -1.0], [1.0, 1.0]]))
    torch.testing.assert_close(morph.source(x), x.norm(dim=1) - 0.3)
    torch.testing.assert_close(morph.target(x), (x - torch.tensor([0.1, 0.0])).norm(dim=1) - 0.4)


def test_the_gradient_of_a_morph_is_its_derivative(file: Path) -> None:
    morph = load_morph(file).double()
    x = (torch.rand(7, 2, dtype=torch.float64) * 2 - 1).requires_grad_()
    torch.testing.assert_close(morph.gradient(x, 0.3), torch.autograd.grad(morph(x, 0.3).sum(), x)[0])


def test_points_or_times_of_another_shape_meet_a_sentence(file: Path) -> None:
    morph = load_morph(file)
    with pytest.raises(ValueError, match=r"`x` must have shape \(n, 2\), got \(7, 3\)\."):
        morph._spacetime(torch.rand(7, 3), 0.0)
    with pytest.raises(ValueError, match=r"`t` must be one time or have shape \(7,\), got \(5,\)\."):
        morph._spacetime(torch.rand(7, 2), torch.rand(5))


def test_a_file_is_read_once(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "checkpoints").mkdir()
    best = file.rename(tmp_path / "checkpoints" / "best.ckpt")
    read: list[Path] = []
    monkeypatch.setattr(checkpoint, "load_torch", lambda path, *words: read.append(path) or load_torch(path, *words))
    nsm.load_morph(tmp_path)
    nsm.load_morph(best)
    assert read == [best, best]


def test_a_folder_means_its_best_checkpoint_and_else_its_last(tmp_path: Path) -> None:
    (tmp_path / "checkpoints").mkdir()
    with pytest.raises(InputError, match=r"which has no checkpoints/best.ckpt\. Try the folder of a finished run"):
        load_morph(tmp_path)
    for name in ("last", "best"):
        save(content(), tmp_path / "checkpoints" / f"{name}.ckpt")
        expected = torch.load(tmp_path / "checkpoints" / f"{name}.ckpt", weights_only=True)["state_dict"]
        assert torch.equal(load_morph(tmp_path).field.linears[0].weight, expected["morph.field.linears.0.weight"])


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"must be an existing file or folder, got .*none.ckpt\. Try"):
        load_morph(tmp_path / "none.ckpt")


@pytest.mark.parametrize("part", [0.0, 0.3, 0.9, 0.999])
def test_a_file_that_is_empty_or_cut(part: float, file: Path) -> None:
    whole = file.read_bytes()
    file.write_bytes(whole[: int(part * len(whole))])
    with pytest.raises(InputError, match=r"a.ckpt` must be a complete checkpoint .*, got a file that cannot be read"):
        load_morph(file)


@pytest.mark.parametrize("data", [b"a text\n", b"\x80\x02.", b"PK\x03\x04 no archive", bytes(1000)])
def test_a_file_of_another_kind(data: bytes, file: Path) -> None:
    file.write_bytes(data)
    with pytest.raises(InputError, match=r"a.ckpt` must be a (complete )?checkpoint"):
        load_morph(file)


@pytest.mark.parametrize(
    "other", [{}, [1, 2], torch.zeros(3), {"state_dict": {}}, {"nsm": {"format": FORMAT}}, {"nsm": 3, "state_dict": {}}]
)
def test_a_file_of_torch_that_is_no_checkpoint_of_nsm(other: Any, file: Path) -> None:
    torch.save(other, file)
    with pytest.raises(InputError, match="must be a checkpoint of nsm, got another file of torch"):
        load_morph(file)


def test_another_format_says_which_version_wrote_it(file: Path) -> None:
    save(content(format=99, version="7.8"), file)
    with pytest.raises(InputError, match=rf"format {FORMAT} for nsm .*, got format 99\. Try nsm 7\.8, which wrote it"):
        load_morph(file)


@pytest.mark.parametrize(
    "model",
    [
        {},
        3,
        None,
        [],
        {"_target_": "nsm.fields.ScalarSiren"},
        {**MODEL, "field": {**MODEL["field"], "hidden_features": 9}},
        {**MODEL, "field": {**MODEL["field"], "color": "red"}},
        {**MODEL, "field": {**MODEL["field"], "hidden_layers": "two"}},
        {**MODEL, "field": {**MODEL["field"], "hidden_features": -3}},
        {**MODEL, "field": None},
        {**MODEL, "source": {"_target_": "nsm.shapes.Ball", "radius": -1.0, "center": [0.0, 0.0]}},
    ],
)
def test_a_description_that_does_not_fit_the_weights(model: Any, file: Path) -> None:
    save(content(model=model), file)
    with pytest.raises(InputError):
        load_morph(file)


def test_weights_that_are_missing(file: Path) -> None:
    whole = content()
    del whole["state_dict"]["morph.field.linears.0.weight"]
    save(whole, file)
    with pytest.raises(InputError, match="must hold weights that fit its model"):
        load_morph(file)


class Bomb:
    """A pickle that makes a file when it is read."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> Any:
        return os.system, (f"touch {self.marker}",)


@pytest.mark.parametrize("place", ["alone", "state_dict", "model", "loops"])
def test_code_hidden_in_a_file_does_not_run(place: str, file: Path, tmp_path: Path) -> None:
    bomb, marker = Bomb(tmp_path / "marker"), tmp_path / "marker"
    hostile = {
        "alone": bomb,
        "state_dict": {**content(), "state_dict": bomb},
        "model": content(model={**MODEL, "field": bomb}),
        "loops": {**content(), "loops": bomb},
    }[place]
    torch.save(hostile, file)
    with pytest.raises(InputError, match="must be a complete checkpoint"):
        load_morph(file)
    assert not marker.exists()


@pytest.mark.parametrize(
    "target",
    [
        "os.system",
        "posix.system",
        "subprocess.call",
        "builtins.eval",
        "builtins.exec",
        "nsm.io.checkpoint.os.system",
        "nsm.cli.files.os.system",
        "nsm.io.checkpoint.torch.load",
        "nsm.io.build.importlib.import_module",
        "nsm.io.build.nn.Linear",
        "nsm.io.checkpoint.describe",
        "nsm.io.checkpoint.nn.Module",
        "nsm.io.checkpoint.Path",
        "nsm.io.mesh.write_mesh",
        "nsm.losses.LevelSet",
        "nsm.fields.velocity.base.nn.Linear",
        "nsm.train.callbacks.Checkpoints",
        "nsm.no_such_module.Thing",
        "nsm",
        "nsm.",
        ".",
        "",
        "torch.nn.Linear",
        "torch.nn.modules.linear.Linear",
        "torch.hub.load",
        "nsmx.fields.ScalarSiren",
        None,
        3,
        ["os.system"],
        {"_target_": "os.system"},
    ],
)
@pytest.mark.parametrize("place", ["model", "field", "beta", "source"])
def test_a_name_that_is_no_module_of_ours_is_not_called(target: Any, place: str, file: Path, tmp_path: Path) -> None:
    marker = tmp_path / "marker"
    node = {"_target_": target, "command": f"touch {marker}", "path": str(marker), "url": "x"}
    model = {
        "model": node,
        "field": {**MODEL, "field": node},
        "beta": {**MODEL, "velocity": {**MODEL["velocity"], "beta": {**node, "_partial_": True}}},
        "source": {**MODEL, "source": node},
    }[place]
    save(content(model=model), file)
    with pytest.raises(InputError, match=r"a.ckpt` cannot be loaded: `_target_` must be a Module .*, got .*\. Try"):
        load_morph(file)
    assert not marker.exists()


READERS = {entry["_target_"] for path in (CONF / "shape").glob("*.yaml") if "path" in (entry := OmegaConf.load(path))}


@pytest.mark.parametrize("target", sorted({*READERS, "nsm.shapes.MeshFile", "nsm.shapes.SirenFile"}))
def test_a_shape_that_reads_files_may_not_be_named(target: str, file: Path) -> None:
    """A checkpoint holds the weights of its end shapes; one that wants a path from this machine is not ours."""
    save(content(model={**MODEL, "source": {"_target_": target, "path": "/etc/passwd"}}), file)
    with pytest.raises(InputError, match="that reads no other file, got"):
        load_morph(file)


def test_the_checkpoint_of_a_still_shape_is_no_morph(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NSM_CACHE_DIR", str(tmp_path / "cache"))
    run = tmp_path / "run"
    assert train_here(*STILL, "sdf.steps=2", f"hydra.run.dir={run}") == 0
    with pytest.raises(InputError, match="must be the checkpoint of a run with `task=morph`, got a SirenShape"):
        load_morph(run)


def test_reading_keeps_the_configuration_and_where_shapes_come_from(file: Path) -> None:
    save(content(config={"seed": 3}, provenance={"source": {"scale": 0.9}}), file)
    entry = read_checkpoint(file)["nsm"]
    assert entry["config"] == {"seed": 3}
    assert entry["provenance"]["source"]["scale"] == 0.9


def test_a_morph_remembers_where_its_shapes_come_from(file: Path) -> None:
    save(content(provenance={"source": {"kind": "mesh", "scale": 0.9}}), file)
    assert load_morph(file).provenance == {"source": {"kind": "mesh", "scale": 0.9}}
