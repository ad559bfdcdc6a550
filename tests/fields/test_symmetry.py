"""Fields and velocities with a mirror plane: exact symmetry, and closed derivatives."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
import torch
from hydra.utils import instantiate
from runs import BARE, composed, train_here
from test_velocity import VELOCITIES, between, field_of, points, target_of, velocity_of
from torch import Tensor
from torch.func import hessian, jacrev, vmap

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.export.safetensors import write_safetensors
from nsm.fields import LipschitzMlp, Mirror, SymmetricField, SymmetricVelocity
from nsm.geometry.reflection import Reflection
from nsm.io.build import build
from nsm.io.checkpoint import load_morph
from nsm.losses import BatchEvaluation, LipschitzBound
from nsm.sampling import Batch
from nsm.shapes import Ball
from nsm.shapes.asymmetry import asymmetry
from nsm.train.preparation import symmetric
from nsm.train.tasks import Keys
from nsm.types import Key

#: Normals and offsets of mirror planes by dimension: an axis through the origin, and any other plane.
PLANES = {2: (([0, 1], 0.0), ([0.6, -0.8], 0.2)), 3: (([1, 0, 0], 0.0), ([1.0, -2.0, 0.5], -0.3))}
every_plane = pytest.mark.parametrize(("dim", "plane"), [(dim, plane) for dim in PLANES for plane in PLANES[dim]])


def made(name: str, dim: int, plane: tuple[list[float], float]) -> tuple[SymmetricField, SymmetricVelocity]:
    field = SymmetricField(field_of(dim), *plane)
    velocity = SymmetricVelocity(velocity_of(name, dim), *plane)
    velocity.attach(field, between(target_of(dim)))
    return field, velocity


@every_plane
def test_a_reflection_is_its_own_inverse_and_keeps_the_plane(dim: int, plane: tuple) -> None:
    mirror, x = Reflection.at(*plane), torch.randn(9, dim, dtype=torch.float64)
    torch.testing.assert_close(mirror.points(mirror.points(x)), x)
    normal = x.new_tensor(mirror.normal)
    assert float(normal.norm()) == pytest.approx(1)
    on = x - (x @ normal - mirror.offset)[:, None] * normal
    torch.testing.assert_close(mirror.points(on), on)
    matrix = mirror.vectors(torch.eye(dim, dtype=torch.float64))
    torch.testing.assert_close(matrix @ matrix.T, torch.eye(dim, dtype=torch.float64))
    assert torch.linalg.det(matrix) == pytest.approx(-1)
    p = torch.cat([x, x[:, :1]], 1)
    torch.testing.assert_close(mirror.points(p), torch.cat([mirror.points(x), x[:, :1]], 1))


@pytest.mark.parametrize("network", ["siren", "lipschitz"])
@every_plane
def test_a_symmetric_field_is_the_mean_of_both_sides_and_its_jet_is_exact(network: str, dim: int, plane: tuple) -> None:
    inner = field_of(dim) if network == "siren" else LipschitzMlp(dim + 1, 8, 2).double()
    field, p, mirror = SymmetricField(inner, *plane), points(12, dim), Reflection.at(*plane)
    torch.testing.assert_close(field(p), (inner(p) + inner(mirror.points(p))) / 2, rtol=0, atol=1e-14)
    torch.testing.assert_close(field(mirror.points(p)), field(p), rtol=0, atol=1e-13)
    jet = field.jet(p)
    torch.testing.assert_close(jet.value, field(p))

    def mean(q: Tensor) -> Tensor:
        return inner(torch.stack([q, mirror.points(q[None])[0]])).mean()

    if network == "siren":
        torch.testing.assert_close(jet.gradient, vmap(jacrev(mean))(p))
        torch.testing.assert_close(field.hessian(p, dim), vmap(hessian(mean))(p)[:, :dim])
    gradients = field.jet(mirror.points(p)).gradient
    torch.testing.assert_close(gradients, mirror.vectors(jet.gradient), rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", VELOCITIES)
@every_plane
def test_a_symmetric_velocity_is_mirrored_exactly(name: str, dim: int, plane: tuple) -> None:
    (field, velocity), p, mirror = made(name, dim, plane), points(12, dim), Reflection.at(*plane)
    there = mirror.points(p)
    here = velocity(p, field.jet(p))
    torch.testing.assert_close(velocity(there, field.jet(there)), mirror.vectors(here), rtol=0, atol=1e-12)
    divergence = velocity.divergence(p, field.jet(p))
    torch.testing.assert_close(velocity.divergence(there, field.jet(there)), divergence, rtol=0, atol=1e-11)
    assert here.norm(dim=1).max() > 1e-3
    # on the plane nothing crosses it
    normal = p.new_tensor(mirror.normal)
    on = (p + there) / 2
    torch.testing.assert_close(velocity(on, field.jet(on)) @ normal, torch.zeros(12).double(), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", VELOCITIES)
@every_plane
def test_the_divergence_is_the_trace_of_the_jacobian(name: str, dim: int, plane: tuple) -> None:
    (field, velocity), p, step = made(name, dim, plane), points(12, dim), 1e-5
    trace = torch.zeros(12, dtype=torch.float64)
    for axis in range(dim):
        shift = step * torch.eye(dim + 1, dtype=torch.float64)[axis]
        ahead, behind = (velocity(q, field.jet(q)) for q in (p + shift, p - shift))
        trace += ((ahead - behind) / (2 * step))[:, axis]
    torch.testing.assert_close(velocity.divergence(p, field.jet(p)), trace, atol=1e-7, rtol=1e-6)
    if name == "nulldiv":
        assert (velocity.divergence(p, field.jet(p)) == 0).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_the_divergence_of_an_adaptive_velocity_vanishes_on_the_surface(dim: int) -> None:
    field, velocity = made("adadiv", dim, PLANES[dim][1])
    p = points(12, dim)
    jet = field.jet(p)
    assert (velocity.divergence(p, jet._replace(value=torch.zeros_like(jet.value))) == 0).all()


@every_plane
def test_second_derivatives_agree_with_nested_differentiation(dim: int, plane: tuple) -> None:
    (field, velocity), p = made("free", dim, plane), points(6, dim)
    value = vmap(lambda q: velocity.velocity.network(q[None])[0])
    mirror = Reflection.at(*plane)

    def mean(q: Tensor) -> Tensor:
        here, there = value(torch.stack([q, mirror.points(q[None])[0]]))
        return (here + mirror.vectors(there)) / 2

    jet, laplacian = velocity.jet_and_laplacian(p)
    torch.testing.assert_close(jet.value, velocity(p, field.jet(p)))
    torch.testing.assert_close(jet.jacobian, vmap(jacrev(mean))(p)[:, :, :dim])
    second = vmap(hessian(mean))(p)[:, :, :dim, :dim]
    torch.testing.assert_close(laplacian, second.diagonal(dim1=2, dim2=3).sum(2))


def test_every_symmetry_of_the_configuration_makes_a_model_that_loads() -> None:
    names = sorted(path.stem for path in (CONF / "symmetry").glob("*.yaml") if path.stem != "none")
    for name in names:
        given = ["symmetry.normal=[1,1,0]"] if name == "plane" else []
        config = composed(f"symmetry={name}", *given, "network.field.hidden_features=8", "velocity=free")
        mirror = instantiate(config.symmetry, _convert_="all")
        for dim in (2, 3):
            if (name, dim) == ("z", 2):
                with pytest.raises(InputError, match=r"`symmetry.normal` must be a direction in 2D, got \[0, 0, 1\]"):
                    mirror.reflection(2)
                continue
            field = build(mirror.field({**config.field, "in_features": dim + 1}, dim)).double()
            p = points(5, dim)
            torch.testing.assert_close(field(mirror.reflection(dim).points(p)), field(p), rtol=0, atol=1e-12)


def test_the_asymmetry_of_a_moved_ball_is_known() -> None:
    """Mirror images of a small circle at distance c from the plane lie on a circle at distance 2 c from it."""
    ball = Ball(0.01, [0.3, 0.0])
    assert asymmetry(ball, Reflection.at([1, 0], 0.0)) == pytest.approx(0.6 - 0.01, abs=2e-4)
    assert asymmetry(ball, Reflection.at([1, 0], 0.3)) < 1e-6
    assert asymmetry(ball, Reflection.at([0, 1], 0.0)) < 1e-6


def test_the_lipschitz_bound_and_the_lack_of_one_pass_through() -> None:
    field = SymmetricField(LipschitzMlp(3, 8, 2), [1, 0])
    batch = Batch(torch.zeros(1, 3), torch.zeros(0), torch.zeros(0, 2))
    assert LipschitzBound(1).residual(BatchEvaluation(batch, field)) == field.network.bound
    without = BatchEvaluation(batch, SymmetricField(field_of(2), [1, 0]))
    with pytest.raises(InputError, match=r"must be a Lipschitz network .*got ScalarSiren"):
        LipschitzBound(1).residual(without)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short training with a mirror plane, of disks on both sides of another."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("symmetric")
        patch.setenv("NSM_CACHE_DIR", str(folder / "cache"))
        assert train_here(*BARE, "symmetry=y", "steps=3", "validations=1", f"hydra.run.dir={folder}") == 0
        return folder


def test_a_trained_morph_is_symmetric_after_loading(run: Path) -> None:
    morph, x = load_morph(run).double(), torch.rand(20, 2, dtype=torch.float64) - 0.5
    mirrored = x * x.new_tensor([1.0, -1.0])
    assert (x[:, 1].abs() > 0.01).all()
    for t in (0.0, 0.6, 1.0):
        torch.testing.assert_close(morph(mirrored, t), morph(x, t), rtol=0, atol=1e-12)
        expected = morph.velocity(x, t) * x.new_tensor([1.0, -1.0])
        torch.testing.assert_close(morph.velocity(mirrored, t), expected, rtol=0, atol=1e-12)


def test_a_symmetric_morph_is_a_program_but_not_weights(run: Path, tmp_path: Path) -> None:
    morph, x = load_morph(run), torch.rand(20, 2) - 0.5
    networks = morph.networks()
    assert networks.description["symmetry"] == {"normal": [0.0, 1.0], "offset": 0.0}
    value, gradient, velocity = networks.program(x, torch.full((20,), 0.3))
    torch.testing.assert_close(value, morph(x, 0.3), atol=1e-5, rtol=0)
    torch.testing.assert_close(gradient, morph.gradient(x, 0.3), atol=1e-4, rtol=0)
    torch.testing.assert_close(velocity, morph.velocity(x, 0.3), atol=1e-4, rtol=0)
    with pytest.raises(InputError, match=r"`format` must be pt2 or onnx for a morph with a symmetry"):
        write_safetensors(tmp_path / "a.safetensors", morph)


def test_ends_without_the_symmetry_are_warned_about(caplog: pytest.LogCaptureFixture) -> None:
    left, right = Ball(0.3, [-0.4, 0.0]), Ball(0.3, [0.4, 0.0])
    model = {"field": {"_target_": "a"}, "velocity": None}
    with caplog.at_level(logging.WARNING):
        keys = Keys((Key(0.0, left), Key(1.0, right)), {})
        made = symmetric(Mirror([0, 1, 0]), model, keys)
        assert made["field"]["network"] == model["field"]
        assert made["velocity"] is None
        assert not caplog.messages
        symmetric(Mirror([1, 0, 0]), model, keys)
    (said,) = caplog.messages
    assert said.startswith("The shapes deviate from `symmetry` by 0.5")


@pytest.mark.parametrize("normal", [[0, 0, 0], [1], [1, 0, 0, 0]])
def test_a_normal_must_be_a_direction(normal: list[float]) -> None:
    with pytest.raises(InputError, match=r"`symmetry.normal` must be a direction in .*Try `symmetry.normal=\[1,0,0\]`"):
        Mirror(normal).reflection(3)
