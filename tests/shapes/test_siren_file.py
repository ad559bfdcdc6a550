"""Shapes that are networks: poses folded into the weights, round trips, and files that are no shape."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
import torch
from hydra.utils import instantiate
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.fields.siren import ScalarSiren
from nsm.shapes import Ball, Similarity, SirenFile, SirenShape, equal_volume

TILTED = {"rotation": [20, -35, 50], "translation": [0.1, -0.05, 0.08], "scale": 0.8}
OFFICIAL = ["kitten", "fandisk", "spot", "bob", "cylinder", "torus", "aligned_feline", "horse", "bust", "max_new"]


def _points(count: int = 300, dim: int = 3) -> Tensor:
    return 2 * torch.rand(count, dim, generator=torch.Generator().manual_seed(3), dtype=torch.float64) - 1


def _state(network: ScalarSiren) -> dict[str, Tensor]:
    """The network as the published files hold theirs."""
    pairs = [(f"net.{i}.0", linear) for i, linear in enumerate(network.linears)]
    return {f"{name}.{kind}": getattr(linear, kind).detach() for name, linear in pairs for kind in ("weight", "bias")}


@pytest.fixture(scope="module")
def ball_network() -> ScalarSiren:
    """A small network fitted to a ball: enough of a signed distance to be taken for one."""
    torch.manual_seed(0)
    network = ScalarSiren(3, 32, 2, omega=5.0)
    optimizer = torch.optim.Adam(network.parameters(), lr=2e-3)
    ball, generator = Ball(0.5), torch.Generator().manual_seed(0)
    for _ in range(400):
        x = 2 * torch.rand(512, 3, generator=generator) - 1
        jet = network.jet(x)
        loss = (jet.value - ball(x)).square().mean() + 0.1 * (jet.gradient.norm(dim=1) - 1).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return network


@pytest.fixture
def ball_file(ball_network: ScalarSiren, tmp_path: Path) -> Path:
    torch.save(_state(ball_network), tmp_path / "ball.pth")
    return tmp_path / "ball.pth"


@pytest.mark.parametrize("dim", [2, 3])
def test_a_pose_is_folded_exactly_into_the_weights(dim: int) -> None:
    move = Similarity.read(TILTED if dim == 3 else {"rotation": 35, "translation": [0.1, 0.2], "scale": 0.7}, dim)
    shape = SirenShape.from_network(ScalarSiren(dim, 32, 3, omega=[20.0, 10.0, 5.0]).double())
    x = _points(dim=dim)
    expected = move.scale * shape((x - move.translation) @ move.rotation / move.scale)
    moved = shape.transformed(move)
    torch.testing.assert_close(moved(x), expected, atol=1e-10, rtol=0)
    torch.testing.assert_close(moved.transformed(move.inverse())(x), shape(x), atol=1e-10, rtol=0)
    torch.testing.assert_close(moved.similarity.after(move.inverse()).scale, 1.0)


def test_the_jet_is_value_and_gradient() -> None:
    shape = SirenShape.from_network(ScalarSiren(3, 16, 2).double())
    x = _points().requires_grad_()
    value = shape(x)
    (gradient,) = torch.autograd.grad(value.sum(), x)
    jet = shape.jet(x.detach())
    torch.testing.assert_close(jet.value, value.detach())
    torch.testing.assert_close(jet.gradient, gradient)


def test_config_and_state_bring_back_the_same_bits() -> None:
    shape = SirenShape.from_network(ScalarSiren(3, 16, 2, omega=[30.0, 7.0]), origin={"kind": "network", "path": "a"})
    shape = shape.transformed(Similarity.read(TILTED, 3))
    again = instantiate(shape.config())
    again.load_state_dict(shape.state_dict())
    x = _points().float()
    assert torch.equal(again(x), shape(x))
    assert again.provenance() == shape.provenance()


def test_an_end_shape_does_not_train() -> None:
    shape = SirenShape.from_network(ScalarSiren(3, 16, 2))
    assert not any(p.requires_grad for p in shape.parameters())


def test_a_copy_is_not_the_network_it_was_made_from() -> None:
    network = ScalarSiren(3, 16, 2)
    shape = SirenShape.from_network(network)
    before = shape(_points().float())
    torch.nn.init.zeros_(network.linears[0].weight)
    assert torch.equal(shape(_points().float()), before)


def test_a_file_is_read_posed_and_known_by_its_hash(ball_network: ScalarSiren, ball_file: Path) -> None:
    x = _points().float()
    torch.testing.assert_close(SirenFile(str(ball_file), omega=5)(x), ball_network(x), atol=1e-6, rtol=0)
    posed = SirenFile(str(ball_file), omega=5, pose=TILTED)
    pose = Similarity.read(posed.provenance()["similarity"], 3)
    torch.testing.assert_close(posed(pose.apply(x)), pose.scale * ball_network(x), atol=1e-5, rtol=0)
    assert len(posed.provenance()["sha256"]) == 64
    assert posed.provenance()["omega"] == 5


def test_volume_and_samples_of_a_network(ball_file: Path, generator: torch.Generator) -> None:
    shape = SirenFile(str(ball_file), omega=5)
    assert shape.volume() == pytest.approx(0.5236, rel=0.1)
    assert shape.transformed(Similarity.scaling(0.5, 3)).volume() == pytest.approx(shape.volume() / 8, rel=1e-6)
    samples = shape.surface_samples(2000, generator)
    assert shape(samples.points).abs().max() < 1e-5
    assert (samples.points * samples.normals).sum(1).min() > 0.3
    result = equal_volume(shape, Ball(0.4))
    assert result.shapes[0].volume() == pytest.approx(result.volume, rel=1e-6)
    x, center = _points().float() * 0.9, shape.bounds().mean(0)
    expected = result.scales[0] * shape(center + (x - center) / result.scales[0])
    torch.testing.assert_close(result.shapes[0](x), expected, atol=1e-5, rtol=0)


@pytest.mark.parametrize("omega", [0.1, 2.0, 12.0, 60.0])
def test_a_wrong_omega_is_noticed(ball_file: Path, omega: float) -> None:
    with pytest.raises(InputError, match=f"`omega` must be .*, got {omega:g}, .*Try `omega=60`"):
        SirenFile(str(ball_file), omega=omega)


class _Hostile:
    def __reduce__(self):
        return (exec, ("raise SystemExit",))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"a": 1}, "must be a state dict of tensors"),
        ([torch.zeros(2)], "must be a state dict of tensors"),
        ({}, "must be a state dict of tensors"),
        (_Hostile(), "must be a state dict written by torch.save"),
        ({"layer.weight": torch.zeros(3, 3)}, "must have the keys"),
        (_state(ScalarSiren(4, 8, 2)), "trained morph, whose fourth input is time"),
        (_state(ScalarSiren(1, 8, 2)), "got 1"),
        ({**_state(ScalarSiren(3, 8, 2)), "net.1.0.weight": torch.zeros(8, 7)}, "one width and 1 output"),
        ({**_state(ScalarSiren(3, 8, 2)), "net.1.0.bias": torch.zeros(7)}, "one width and 1 output"),
        ({**_state(ScalarSiren(3, 8, 2)), "net.2.0.bias": torch.tensor([torch.nan])}, "must have finite weights"),
    ],
)
def test_files_that_hold_no_shape(content: object, words: str, tmp_path: Path) -> None:
    torch.save(content, tmp_path / "a.pth")
    with pytest.raises(InputError, match=words):
        SirenFile(str(tmp_path / "a.pth"))


def test_damaged_files(ball_file: Path, tmp_path: Path) -> None:
    for content in (b"", b"hello", ball_file.read_bytes()[:2000], pickle.dumps(_Hostile())):
        (tmp_path / "cut.pth").write_bytes(content)
        with pytest.raises(InputError, match=r"must be a state dict written by torch\.save"):
            SirenFile(str(tmp_path / "cut.pth"))


@pytest.mark.parametrize("name", OFFICIAL)
def test_published_networks_are_signed_distances(name: str, data_dir: Path, generator: torch.Generator) -> None:
    shape = SirenFile(f"official/ni/{name}.pth")
    low, high = shape.bounds()
    assert -1 < low.min() < high.max() < 1
    samples = shape.surface_samples(1000, generator)
    assert shape(samples.points).abs().quantile(0.99) < 1e-4
    assert float(shape.jet(samples.points).gradient.norm(dim=1).mean()) == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(("name", "omega"), [("kitten", 30), ("spot", 15), ("cylinder", 1), ("bust", 45)])
def test_published_networks_at_a_wrong_omega(name: str, omega: float, data_dir: Path) -> None:
    with pytest.raises(InputError, match=f"got {omega}, .* Try `omega=60`"):
        SirenFile(f"official/ni/{name}.pth", omega=omega)


def test_a_published_morph_is_no_shape(data_dir: Path) -> None:
    with pytest.raises(InputError, match="trained morph"):
        SirenFile("official/morphs/kitten-fandisk/best.pth")


@pytest.mark.parametrize(("primitive", "network"), [("cylinders", "cylinder"), ("torus", "torus")])
def test_the_default_primitives_are_the_published_pair(primitive: str, network: str, data_dir: Path) -> None:
    from omegaconf import OmegaConf

    from nsm.cli.configuration import CONF

    exact = instantiate(OmegaConf.load(CONF / "shape" / f"{primitive}.yaml"))
    points = exact.surface_samples(2000, torch.Generator().manual_seed(0)).points
    assert SirenFile(f"official/ni/{network}.pth")(points).abs().mean() < 2e-3
