"""Shapes where they are known: domains of networks, true distances, meshes in any coordinates, and the start of f."""

from __future__ import annotations

import copy
import logging
import math
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import torch
import trimesh
from torch.func import jacrev, vmap

from nsm.cli.errors import InputError
from nsm.fields import ScalarSiren
from nsm.io.build import build
from nsm.shapes import Ball, MeshFile, MeshShape, PointCloud, Similarity, SirenFile, SirenShape
from nsm.train.tasks import prepare_keys, starting_network
from nsm.train.tasks.fit import SdfFit, realize

#: Meshes need no fit.
NO_FIT = mock.Mock(spec=SdfFit, side_effect=AssertionError)
POSE = {"rotation": [20, -35, 50], "translation": [0.05, 0, -0.05], "scale": 0.9}


@torch.no_grad()
def bowl(level: float = 2.5, frequency: float = 1.5, omega: float = 2.0) -> ScalarSiren:
    """level − Σ cos(k x_i): a rounded ball around the origin, repeated at every 2π/k, and no distance."""
    network = ScalarSiren(3, 4, 1, omega)
    hidden, last = network.linear_layers
    hidden.weight.zero_()
    hidden.weight[:3] = torch.eye(3) * frequency / omega
    hidden.bias.fill_(math.pi / 2 / omega)
    hidden.bias[3] = 0
    last.weight.fill_(-1)
    last.weight[0, 3] = 0
    last.bias.fill_(level)
    return network


def blob(**arguments: object) -> SirenShape:
    return SirenShape.from_network(bowl(), domain=[[-1.0] * 3, [1.0] * 3], **arguments)


def scattered(count: int, width: float) -> torch.Tensor:
    return width * (2 * torch.rand(count, 3, generator=torch.Generator().manual_seed(1)) - 1)


def ellipsoid(path: Path, scale: float = 1.0, shift: float = 0.0) -> str:
    mesh = trimesh.creation.icosphere(3)
    mesh.vertices = mesh.vertices * np.array([0.5, 0.3, 0.8]) * scale + shift
    path.write_text(
        "".join(f"v {x:.17g} {y:.17g} {z:.17g}\n" for x, y, z in mesh.vertices)
        + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in mesh.faces)
    )
    return str(path)


def test_a_moved_network_has_the_scaled_volume_without_another_evaluation() -> None:
    shape = blob()
    volume = shape.volume()
    larger = shape.transformed(Similarity.about(torch.tensor([0.1, 0.2, 0.3], dtype=torch.double), 1.5))
    with mock.patch.object(SirenShape, "local_distance", side_effect=AssertionError):
        assert larger.volume() == pytest.approx(1.5**3 * volume)
    assert blob().transformed(larger.placement).volume() == pytest.approx(1.5**3 * volume)


class TestDomain:
    """Networks are read where they were trained, and nowhere else."""

    def test_outside_its_domain_a_network_goes_on_as_a_distance(self) -> None:
        # the bare network is negative again around (2π/k, 0, 0), k = 1.5
        far = torch.tensor([[2 * math.pi / 1.5, 0.0, 0.0]])
        assert bowl()(far) < -0.4
        at_the_face = float(bowl()(torch.tensor([[1.0, 0, 0]])))
        assert float(blob()(far)) == pytest.approx(at_the_face + float(far[0, 0]) - 1, abs=1e-6)
        x = scattered(4000, 4.0)
        outside = x.abs().amax(1) > 1
        assert (blob()(x[outside]) > 0).all()
        assert torch.equal(blob()(x[~outside]), bowl()(x[~outside]))

    def test_it_is_continuous_and_its_gradient_is_that_of_the_field(self) -> None:
        shape = blob(pose=POSE).transformed(Similarity.read(POSE, 3))
        x = scattered(500, 3.0).double()
        shape.network.double()
        jet = shape.jet(x)
        torch.testing.assert_close(jet.value, shape(x))
        torch.testing.assert_close(jet.gradient, vmap(jacrev(lambda p: shape(p[None])[0]))(x), atol=1e-9, rtol=0)
        face = torch.tensor([[1.0, 0.2, -0.3]]).double()
        at, beyond = (shape(shape.placement.apply(face * s)) for s in (1.0, 1 + 1e-9))
        torch.testing.assert_close(at, beyond, atol=1e-8, rtol=0)

    def test_volume_and_surface_are_those_of_the_domain_wherever_it_lies(self) -> None:
        here = blob()
        for move in (Similarity.read({"scale": 0.01}, 3), Similarity.read({"scale": 40, "translation": [9, 0, 0]}, 3)):
            there = here.transformed(move)
            assert there.volume() == pytest.approx(here.volume() * move.scale**3, rel=1e-9)
            torch.testing.assert_close(there.exact_bounds(), move.apply(here.exact_bounds()), rtol=1e-9, atol=1e-12)

    def test_a_file_is_trained_in_the_unit_box(self, data_dir: Path) -> None:
        shape = SirenFile("official/ni/kitten.pth", pose=POSE)
        assert torch.equal(shape.local_box(), torch.tensor([[-1.0] * 3, [1.0] * 3]))
        assert (shape(shape.placement.apply(2 * scattered(2000, 1.0) / 1.0 + 3)) > 0).all()
        again = build(shape.config())
        again.load_state_dict(shape.state_dict())
        x = scattered(200, 2.0)
        assert torch.equal(again(x), shape(x))

    @pytest.mark.parametrize(("half_width", "covered"), [(1.0, True), (1.01, False)])
    def test_it_knows_which_box_it_covers(self, half_width: float, covered: bool) -> None:
        assert blob().covers(half_width) == covered
        assert blob().transformed(Similarity.scaling(2, 3)).covers(2 * half_width) == covered
        assert not SirenShape.from_network(bowl()).covers(half_width)


class TestTrueDistance:
    """Targets are distances to the surface, whatever the network holds."""

    def test_a_network_that_is_no_distance_has_true_ones_everywhere(self, caplog: pytest.LogCaptureFixture) -> None:
        # cos x + cos y + cos z > 5/2 is a ball of radius 0.68/1.5 to 2 %
        shape = SirenShape.from_network(bowl(frequency=3.0), domain=[[-1.0] * 3, [1.0] * 3])
        x = scattered(3000, 1.5)
        exact = Ball(shape.bounds()[1, 0].item())(x)
        assert (shape(x) - exact).abs().max() > 0.5
        assert (shape.true_distance(x) - exact).abs().max() < 0.02
        with caplog.at_level(logging.INFO):
            shape.log_deviation()
        assert "the network deviates from a distance" in caplog.text
        samples = shape.distance_samples(2000, torch.Generator().manual_seed(0))
        assert (samples.distances - Ball(shape.bounds()[1, 0].item())(samples.points)).abs().max() < 0.02

    def test_very_near_the_surface_the_network_decides(self) -> None:
        shape = blob()
        on = shape.surface_samples(500, torch.Generator().manual_seed(0))
        for step in (-1e-3, 0.0, 1e-3):
            torch.testing.assert_close(
                shape.true_distance(on.points + step * on.normals), torch.full((500,), step), atol=2e-5, rtol=0
            )

    def test_it_scales_with_the_shape(self) -> None:
        shape, move = blob(), Similarity.read(POSE, 3)
        x = scattered(300, 1.5)
        moved = shape.transformed(move).true_distance(move.apply(x))
        torch.testing.assert_close(moved, move.scale * shape.true_distance(x), atol=1e-5, rtol=0)

    def test_a_published_network_that_strays(self, data_dir: Path, caplog: pytest.LogCaptureFixture) -> None:
        shape = SirenFile("official/ni/max_new.pth")
        with caplog.at_level(logging.INFO):
            shape.log_deviation()
        assert "official/ni/max_new.pth deviates from a distance" in caplog.text
        x, mesh = scattered(1000, 1.5), shape.surface()
        cloud = mesh.vertices[mesh.simplices].mean(1)
        nearest = torch.cat([torch.cdist(part, cloud).amin(1) for part in x.split(100)])
        assert (shape.true_distance(x).abs() - nearest).abs().max() < 0.01


class TestMesh:
    """Meshes are exact end shapes, in coordinates of any size and place."""

    def test_the_jet_is_analytic(self, tmp_path: Path) -> None:
        trimesh.creation.box((1, 1, 1)).export(tmp_path / "box.obj")
        shape = MeshFile(str(tmp_path / "box.obj"), fit=0.5)
        x = torch.tensor([[0.9, 0, 0], [0.4, 0.1, 0], [0.5, 0.1, 0.2], [0.8, 0.9, 0]], dtype=torch.float64)
        jet = shape.jet(x)
        torch.testing.assert_close(jet.value, torch.tensor([0.4, -0.1, 0, 0.5], dtype=torch.float64))
        wanted = torch.tensor([[1, 0, 0], [1, 0, 0], [1, 0, 0], [0.6, 0.8, 0]], dtype=torch.float64)
        torch.testing.assert_close(jet.gradient, wanted)
        x.requires_grad_()
        (gradient,) = torch.autograd.grad(shape(x).sum(), x)
        torch.testing.assert_close(gradient, wanted)

    def test_it_comes_back_from_config_and_state_alone(self, tmp_path: Path) -> None:
        shape = MeshFile(ellipsoid(tmp_path / "a.obj"), pose=POSE)
        torch.save([shape.config(), shape.state_dict()], tmp_path / "shape.pt")
        (tmp_path / "a.obj").unlink()
        config, state = torch.load(tmp_path / "shape.pt", weights_only=True)
        again = build(config)
        assert type(again) is MeshShape
        again.load_state_dict(state)
        x = scattered(300, 1.5)
        assert torch.equal(again(x), shape(x))
        assert torch.equal(copy.deepcopy(again)(x), shape(x))
        assert again.provenance() == shape.provenance()
        assert again.volume() == shape.volume()
        with pytest.raises(InputError, match="must be a Module of nsm that reads no other file"):
            build({"_target_": "nsm.shapes.MeshFile", "path": str(tmp_path / "a.obj")})

    @pytest.mark.parametrize("scale", [0.001, 1.0, 1000.0])
    @pytest.mark.parametrize("shift", [0.0, 100.0])
    def test_units_and_place_of_the_file_do_not_matter(self, scale: float, shift: float, tmp_path: Path) -> None:
        plain = prepare_keys([MeshFile(ellipsoid(tmp_path / "a.obj")), Ball(0.3)], NO_FIT)
        path = ellipsoid(tmp_path / "b.obj", scale, shift)
        ends = prepare_keys([MeshFile(path), Ball(0.3)], NO_FIT)
        x = scattered(500, 1.5).double()
        torch.testing.assert_close(ends.source(x), plain.source(x), atol=1e-9, rtol=0)
        torch.testing.assert_close(ends.target(x), plain.target(x), atol=1e-9, rtol=0)
        assert ends.source.volume() == pytest.approx(ends.target.volume(), rel=1e-9)
        low, high = ends.source.similarity.inverse().apply(ends.source.exact_bounds())
        size = torch.tensor([0.5, 0.3, 0.8], dtype=torch.float64) * scale
        torch.testing.assert_close(high - low, 2 * size, rtol=1e-4, atol=0)
        torch.testing.assert_close((high + low) / 2, torch.full((3,), shift).double(), rtol=1e-9, atol=1e-9 * scale)

    def test_the_coordinates_of_a_file_are_kept_anywhere(self, tmp_path: Path) -> None:
        pair = [
            MeshFile(ellipsoid(tmp_path / f"{name}.obj", 50.0, shift), fit=None)
            for name, shift in (("a", 900.0), ("b", 930.0))
        ]
        assert pair[0].volume() == pytest.approx(4 / 3 * math.pi * 0.12 * 50**3, rel=0.03)
        ends = prepare_keys(pair, NO_FIT)
        apart = (ends.target.exact_bounds() - ends.source.exact_bounds()).mean(0)
        common = ends.source.similarity.scale
        torch.testing.assert_close(apart, torch.full((3,), 30 * common, dtype=torch.float64), rtol=1e-9, atol=0)
        assert ends.provenance["source"]["scale"] == pytest.approx(1, abs=1e-9)

    def test_a_mesh_end_is_the_mesh_itself(self, tmp_path: Path) -> None:
        shape = MeshFile(ellipsoid(tmp_path / "a.obj"))
        fit = mock.Mock(spec=SdfFit)
        assert realize(shape, fit) is shape
        fit.assert_not_called()


class TestStart:
    """f starts from the source in all of its box."""

    def test_a_network_that_covers_the_box_is_taken_and_another_is_fitted(self) -> None:
        field, fit = ScalarSiren(4, 4, 1), mock.Mock(spec=SdfFit, half_width=1.5)
        wide = SirenShape.from_network(bowl(), domain=[[-2.0] * 3, [2.0] * 3]).transformed(Similarity.scaling(0.8, 3))
        x = scattered(100, 1.5)
        torch.testing.assert_close(starting_network(field, wide, fit)(x), wide(x), atol=1e-6, rtol=0)
        fit.assert_not_called()
        narrow, fit.return_value = blob(), wide
        starting_network(field, narrow, fit)
        assert fit.call_args.args[0] is narrow

    def test_points_may_lie_anywhere(self, tmp_path: Path) -> None:
        ball = trimesh.creation.icosphere(4)
        rows = np.concatenate([1000 + 20 * ball.vertices, ball.vertex_normals], 1)
        np.savetxt(tmp_path / "a.xyz", rows)
        cloud = PointCloud(str(tmp_path / "a.xyz"), fit=None)
        assert cloud.volume() == pytest.approx(4 / 3 * math.pi * 20**3, rel=0.05)
        fit = mock.Mock(spec=SdfFit, side_effect=lambda shape: Ball(0.9))
        field = realize(cloud, fit)
        torch.testing.assert_close(fit.call_args.args[0].bounds(), torch.tensor([[-0.9] * 3, [0.9] * 3]))
        torch.testing.assert_close(field.bounds(), torch.tensor([[980.0] * 3, [1020.0] * 3]), rtol=1e-4, atol=0)


@pytest.mark.parametrize("up", [[0, 1, 0], [0, 0, 1], [0, -1, 0], [1, 0, 0], [0.3, -0.2, 0.5]])
def test_the_direction_that_is_up_becomes_y(up: list[float], tmp_path: Path) -> None:
    turn = Similarity.upright(up, 3)
    direction = torch.tensor([up], dtype=torch.float64)
    wanted = torch.tensor([[0, float(direction.norm()), 0]], dtype=torch.float64)
    torch.testing.assert_close(turn.apply(direction), wanted)
    torch.testing.assert_close(turn.rotation.det(), torch.tensor(1.0, dtype=torch.float64))
    shape = MeshFile(ellipsoid(tmp_path / "a.obj"), up=up, pose={"translation": [0.1, 0, 0]})
    back = shape.similarity.inverse().apply(shape.exact_bounds().mean(0, keepdim=True))
    torch.testing.assert_close(back, torch.zeros(1, 3).double(), atol=0.02, rtol=0)
