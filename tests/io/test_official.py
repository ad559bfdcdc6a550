"""The authors' trained morphs: that they are read as they were written, and that a wrong reading is found out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
import torch

from nsm.cli.errors import InputError
from nsm.io.official import PAIRS, load_official, official_name, read_morph
from nsm.morphs.neural import NeuralMorph
from nsm.shapes import Ball, SirenFile


@pytest.mark.parametrize("name", PAIRS)
def test_names_of_experiments_and_of_folders_mean_the_same(name: str) -> None:
    assert official_name(name) == official_name(PAIRS[name].folder) == name


@pytest.mark.parametrize("name", ["kitten", "spot-bo", "", "../bust-max"])
def test_an_unknown_pair_is_answered_by_the_known_ones(name: str) -> None:
    with pytest.raises(InputError, match=r"`official` must be one of kitten_fandisk, .*twist, got .*\. Try `official="):
        load_official(name)


@pytest.mark.parametrize("name", PAIRS)
def test_published_morphs_join_their_shapes_and_keep_their_volume(name: str, data_dir: Path) -> None:
    morph = load_official(name)
    assert morph.dim == 3
    x = 2 * torch.rand(20000, 3) - 1
    for time, shape in ((0.0, morph.source), (1.0, morph.target)):
        wrong = ((morph(x, time) < 0) != (shape(x) < 0)).double().mean()
        assert wrong < 0.006
    on = x[morph(x, 0.5).abs() < 0.05]
    velocity = morph.velocity(on, 0.5)
    divergence = morph.divergence(on, 0.5)
    assert velocity is not None
    assert divergence is not None
    # β and β' vanish on the surface, and near it they are small
    assert divergence.abs().mean() < 0.05 * max(1.0, float(velocity.norm(dim=1).mean()))


def test_a_morph_is_turned_like_its_shapes(data_dir: Path) -> None:
    folder = data_dir / "official" / "morphs" / "spot-bob"

    def read(pose: Mapping[str, Any] | None, up: Sequence[float] | None = None) -> NeuralMorph:
        ends = (SirenFile(f"official/ni/{name}.pth", pose=pose, up=up) for name in ("spot", "bob"))
        return read_morph(folder / "best.pth", folder / "weights_V.pth", *ends, 30.0)

    lying, turned = read(None), read({"rotation": [0, 90, 0]}, up=[0, 0, 1])
    assert isinstance(turned.source, SirenFile)
    rotation = turned.source.similarity.rotation.float()
    # the direction that is up in the files is up, by a proper rotation
    torch.testing.assert_close(rotation @ torch.tensor([0.0, 0, 1]), torch.tensor([0.0, 1, 0]), atol=1e-6, rtol=0)
    assert torch.det(rotation) == pytest.approx(1)
    x = torch.rand(500, 3) - 0.5
    y = x @ rotation.T
    for time in (0.0, 0.3, 1.0):
        torch.testing.assert_close(turned(y, time), lying(x, time), atol=1e-5, rtol=0)
        torch.testing.assert_close(turned.gradient(y, time), lying.gradient(x, time) @ rotation.T, atol=1e-4, rtol=0)
        torch.testing.assert_close(turned.velocity(y, time), lying.velocity(x, time) @ rotation.T, atol=1e-3, rtol=0)
        torch.testing.assert_close(turned.divergence(y, time), lying.divergence(x, time), atol=1e-2, rtol=0)


@pytest.mark.parametrize("arguments", [{"omega": 60.0}, {"omega": 0.9}])
def test_a_wrong_omega_of_f(arguments: dict[str, float], data_dir: Path) -> None:
    with pytest.raises(InputError, match=r"must be the end shape at t = 0, .*\. Try `omega=1`"):
        load_official("cylinders_torus", **arguments)


@pytest.mark.parametrize(("name", "omega"), [("cylinders_torus", 30.0), ("cylinders_torus", 1.0), ("spot_bob", 60.0)])
def test_a_wrong_omega_of_the_velocity(name: str, omega: float, data_dir: Path) -> None:
    with pytest.raises(InputError, match=f"_V.pth must be a velocity that advects f, .*`velocity_omega={omega:g}`"):
        load_official(name, velocity_omega=omega)


def test_a_wrong_omega_of_the_ends(data_dir: Path) -> None:
    with pytest.raises(InputError, match=r"`omega` must be .*, got 30,"):
        load_official("spot_bob", ends_omega=30.0)


def test_files_that_do_not_belong_together(data_dir: Path, tmp_path: Path) -> None:
    folder = data_dir / "official" / "morphs"
    field, velocity = folder / "spot-bob" / "best.pth", folder / "spot-bob" / "weights_V.pth"
    spot, bob = (SirenFile(f"official/ni/{name}.pth") for name in ("spot", "bob"))
    with pytest.raises(InputError, match="must be the end shape at t = 0"):
        read_morph(field, velocity, bob, spot, 30.0)
    with pytest.raises(InputError, match="one width and 4 outputs"):
        read_morph(field, field, spot, bob, 30.0)
    with pytest.raises(InputError, match="one width and 1 output"):
        read_morph(velocity, velocity, spot, bob, 30.0)
    with pytest.raises(InputError, match="must have 4 inputs, got 3"):
        read_morph(data_dir / "official" / "ni" / "spot.pth", velocity, spot, bob, 30.0)
    with pytest.raises(InputError, match="must be a velocity that advects f"):
        read_morph(field, folder / "bust-max" / "weights_V.pth", spot, bob, 30.0)
    state = torch.load(field, map_location="cpu", weights_only=True)
    torch.save({f"f.{key}": value for key, value in state.items()}, tmp_path / "keys.pth")
    with pytest.raises(InputError, match=r"must have the keys .*, got f\.net"):
        read_morph(tmp_path / "keys.pth", velocity, spot, bob, 30.0)
    with pytest.raises(InputError, match="must have 3 inputs"):
        read_morph(field, velocity, Ball(0.5, [0, 0]), Ball(0.5, [0, 0]), 30.0)


def test_one_published_velocity_is_a_copy_of_f(data_dir: Path) -> None:
    folder = data_dir / "official" / "morphs" / "aligned_feline-horse"
    f, v = (torch.load(folder / f"{name}.pth", map_location="cpu", weights_only=True) for name in ("best", "best_V"))
    assert all(torch.equal(v[key], f[key]) for key in ("net.6.0.weight", "net.6.0.bias"))
    hidden = [key for key in f if not key.startswith("net.6")]
    assert all(torch.allclose(60 * v[key], f[key], rtol=1e-5) for key in hidden)
