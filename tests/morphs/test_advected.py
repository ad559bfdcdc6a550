"""Meshes advected by a morph: volume, attributes, correspondences, and errors."""

from __future__ import annotations

import logging
from functools import partial
from pathlib import Path

import pytest
import torch
from analytic import shrinking
from problems import (
    MOTIONS,
    rotating_box,
    squashed_ball,
    squashed_box,
    trajectory,
    translating_ball,
)
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.fields import Free, NullDiv, VectorSiren, Velocity
from nsm.geometry.advection import RungeKutta, advect
from nsm.geometry.meshing import extract_surface
from nsm.geometry.topology import enclosed_volume
from nsm.morphs.advected import LevelProjection, advect_mesh, advect_surface, correspondences, place_mesh
from nsm.morphs.growth import Grown, VolumeLinear
from nsm.morphs.neural import NeuralMorph
from nsm.shapes import Ball, SirenFile
from nsm.shapes.textured import Attributes, TexturedMesh, load_textured
from nsm.types import Jet, SimplexMesh


@pytest.mark.parametrize("motion", [rotating_box, squashed_box, squashed_ball, translating_ball])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_carried_surface_keeps_its_volume_and_lies_on_the_moving_one(motion: type, dim: int) -> None:
    morph = motion(dim)
    carried = advect_surface(morph, [0.0, 0.5, 1.0], 24)
    volumes = [enclosed_volume(carried.mesh(index)) for index in range(3)]
    assert volumes == pytest.approx([volumes[0]] * 3, rel=1e-7)
    values = torch.stack([morph(x, t) for x, t in zip(carried.vertices, carried.times, strict=True)])
    assert float((values - values[0]).abs().max()) < 1e-7


def test_a_growing_ball_grows() -> None:
    morph = MOTIONS["growing_ball"](3)
    carried = advect_surface(morph, [1.0, 0.0], 24)
    growth = enclosed_volume(carried.mesh(0)) / enclosed_volume(carried.mesh(1))
    assert growth == pytest.approx(morph.volume(1.0) / morph.volume(0.0), rel=0.01)
    assert float(morph(carried.vertices[0], 1.0).abs().max()) < 0.01


def test_a_grown_morph_carries_to_its_wanted_volume() -> None:
    morph = Grown(squashed_ball(3), VolumeLinear(3, 1.0, 1.5))
    carried = advect_surface(morph, [0.0, 1.0], 24)
    assert enclosed_volume(carried.mesh(1)) / enclosed_volume(carried.mesh(0)) == pytest.approx(1.5, rel=1e-5)


def ball_mesh(dim: int, resolution: int) -> SimplexMesh:
    """A ball of radius 0.5, or a disk."""
    box = torch.tensor([[-1.0] * dim, [1.0] * dim], dtype=torch.float64)
    return extract_surface(lambda x: x.norm(dim=1) - 0.5, box, resolution)


def carried_volume_change(field: Velocity, mesh: SimplexMesh) -> float:
    """By what part the volume of a mesh changes that is carried from 0 to 1."""

    def velocity(x: Tensor, t: float) -> Tensor:
        p = torch.cat([x, torch.full((len(x), 1), t, dtype=x.dtype)], 1)
        return field(p, Jet(p[:, 0], torch.zeros_like(p)))

    moved = advect(velocity, mesh.vertices, [0.0, 1.0])[-1]
    assert float((moved - mesh.vertices).norm(dim=1).mean()) > 0.05
    return abs(enclosed_volume(mesh._replace(vertices=moved)) / enclosed_volume(mesh) - 1)


@pytest.mark.parametrize(("dim", "resolutions"), [(2, (100, 400)), (3, (16, 48))])
def test_any_field_without_divergence_keeps_the_volume_and_a_free_one_need_not(
    dim: int, resolutions: tuple[int, int]
) -> None:
    changes = {}
    for kind in (NullDiv, Free):
        torch.manual_seed(1)
        network = partial(VectorSiren, hidden_features=16, hidden_layers=1, omega=4.0)
        field = kind(dim, network).double().requires_grad_(False)
        for linear in field.network.linears:
            linear.weight.mul_(2.0)
        changes[kind] = [carried_volume_change(field, ball_mesh(dim, resolution)) for resolution in resolutions]
    # what is left is that of triangles for a curved surface, of order 2
    coarse, fine = changes[NullDiv]
    assert fine < 1e-3
    assert fine < coarse / 6
    assert changes[Free][1] > 10 * fine


def test_attributes_and_connectivity_are_left_alone_and_seams_stay_closed() -> None:
    mesh = ball_mesh(3, 24)
    twice = SimplexMesh(torch.cat([mesh.vertices, mesh.vertices[:50]]), mesh.simplices)
    look = Attributes(torch.rand(len(twice.vertices), 3), others={"weight": torch.rand(len(twice.vertices))})
    carried = advect_mesh(squashed_ball(3), TexturedMesh(twice, look), [0.5, 1.0], RungeKutta(8))
    assert carried.times == [0.5, 1.0]
    assert carried.vertices.shape == (2, *twice.vertices.shape)
    assert torch.equal(carried.simplices, twice.simplices)
    assert carried.attributes is look
    assert torch.equal(carried.vertices[:, :50], carried.vertices[:, -50:])
    expected = trajectory(squashed_ball(3), twice.vertices, 1.0)
    assert float((carried.vertices[1] - expected).abs().max()) < 1e-4


def test_correspondences_are_those_of_the_exact_motion() -> None:
    morph = rotating_box(3)
    carried = advect_surface(morph, [0.0, 1.0], 32)
    pairs = correspondences(morph, carried, 32)
    expected = trajectory(morph, pairs.source_points, 1.0)
    cell = 2 / 32
    assert float((pairs.target_points - expected).norm(dim=1).max()) < cell / 2
    torch.testing.assert_close((pairs.target_points - expected).norm(dim=1), pairs.distances, rtol=0, atol=1e-6)
    assert float(pairs.distances.mean()) < 0.05 * cell
    with pytest.raises(InputError, match="must go from 0 to 1 for correspondences"):
        correspondences(morph, advect_surface(morph, [0.0, 0.5], 16), 16)


def test_a_morph_without_velocity_says_so_in_one_sentence() -> None:
    with pytest.raises(InputError, match="must have a velocity to advect a surface"):
        advect_surface(shrinking(3, 0.1), [0.0, 1.0], 16)


def test_a_morph_without_surface_at_the_start() -> None:
    morph = translating_ball(2)
    morph.bounds = morph.bounds + 5
    with pytest.raises(InputError, match="high enough to show a surface at t = 0"):
        advect_surface(morph, [0.0, 1.0], 16)
    empty = SimplexMesh(torch.empty(0, 2), torch.empty(0, 2, dtype=torch.long))
    with pytest.raises(InputError, match="must have vertices to be advected"):
        advect_mesh(morph, TexturedMesh(empty), [0.0, 1.0])


def test_points_that_lose_the_surface_are_reported(caplog: pytest.LogCaptureFixture) -> None:
    far = SimplexMesh(torch.tensor([[0.9, 0.9], [0.8, 0.9]], dtype=torch.float64), torch.tensor([[0, 1]]))
    morph = translating_ball(2)
    with caplog.at_level(logging.WARNING):
        carried = advect_mesh(morph, TexturedMesh(far), [0.0, 1.0], project=LevelProjection(morph))
    assert "66 of 66 projections found no surface" in caplog.text
    torch.testing.assert_close(carried.vertices[1], trajectory(morph, far.vertices, 1.0))


def test_a_mesh_is_placed_where_the_source_lies(caplog: pytest.LogCaptureFixture) -> None:
    source = Ball(0.5, [3.0, 0.0, 0.0], pose={"translation": [-3.0, 0.0, 0.0]})
    field = shrinking(3, 0.1).field
    morph = NeuralMorph(field, None, source, source)
    mesh = TexturedMesh(SimplexMesh(torch.tensor([[3.5, 0, 0], [3, 0.5, 0], [3, 0, 0.5]]), torch.tensor([[0, 1, 2]])))
    with caplog.at_level(logging.WARNING):
        there = place_mesh(morph, mesh)
    torch.testing.assert_close(there.mesh.vertices, torch.eye(3) / 2)
    assert "from the surface at t = 0" in caplog.text  # for f is no ball of that radius
    with pytest.raises(InputError, match="has no coordinates of a file"):
        place_mesh(rotating_box(3), mesh)


def test_a_published_mesh_lies_on_its_network_wherever_that_is_posed(data_dir: Path) -> None:
    pose = {"rotation": [0, 30, 0], "scale": 0.7, "translation": [0.1, 0, 0]}
    source = SirenFile(str(data_dir / "official" / "ni" / "cylinder.pth"), pose=pose)
    mesh = load_textured(data_dir / "official" / "meshes" / "cylinder.ply")
    vertices = place_mesh(NeuralMorph(shrinking(3, 0.1).field, None, source, source), mesh).mesh.vertices
    assert float(source(vertices[::20]).abs().mean()) < 0.005
