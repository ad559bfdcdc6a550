"""Points and meshes carried by a velocity go where exact motions take them, and take along what they have."""

from __future__ import annotations

import logging
import math
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from analytic import shrinking
from PIL import Image
from problems import MOTIONS, GrowingBall, LinearMotion, rotating_box, squashed_ball, squashed_box, translating_ball
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.fields import Free, NullDiv, VectorSiren, Velocity
from nsm.geometry import advection
from nsm.geometry.advection import RungeKutta, advect
from nsm.geometry.meshing import extract_surface
from nsm.geometry.projection import project_to_level
from nsm.geometry.topology import enclosed_volume
from nsm.morphs.advected import LevelProjection, carry_mesh, carry_surface, correspondences, placed
from nsm.morphs.growth import Grown, VolumeLinear
from nsm.morphs.neural import NeuralMorph
from nsm.shapes import Ball, SirenFile
from nsm.shapes.textured import Attributes, TexturedMesh, load_textured
from nsm.types import Jet, SimplexMesh


def trajectory(motion: LinearMotion | GrowingBall, x: Tensor, t: float) -> Tensor:
    """Where the points x of t = 0 are at t."""
    if isinstance(motion, GrowingBall):
        return x + t * motion.growth * x / x.norm(dim=1, keepdim=True)
    return (x - motion.start) @ torch.matrix_exp(t * motion.matrix).T + motion.start + t * motion.drift


def cloud(dim: int, count: int = 40) -> Tensor:
    """Points in [-0.8, 0.8]^d, none at the origin."""
    return 1.6 * torch.rand(count, dim, dtype=torch.float64) - 0.8


def swirl(x: Tensor, t: float) -> Tensor:
    """A motion without divergence that is linear in nothing: rotation by |x|² sin(t) about the origin."""
    return x.square().sum(1, keepdim=True) * math.cos(t) * torch.stack([-x[:, 1], x[:, 0]], 1)


def swirled(x: Tensor, t: float) -> Tensor:
    """Where `swirl` takes the points x of t = 0."""
    angle = x.square().sum(1) * math.sin(t)
    cos, sin = angle.cos(), angle.sin()
    return torch.stack([cos * x[:, 0] - sin * x[:, 1], sin * x[:, 0] + cos * x[:, 1]], 1)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", MOTIONS)
def test_points_follow_the_exact_motion(name: str, dim: int) -> None:
    motion, x, times = MOTIONS[name](dim), cloud(dim), [0.0, 0.3, 1.0]
    carried = advect(motion.velocity, x, times, RungeKutta(32))
    expected = torch.stack([trajectory(motion, x, t) for t in times])
    assert carried.shape == (3, 40, dim)
    assert carried.dtype == torch.float64
    assert torch.equal(carried[0], x)
    assert float((carried - expected).abs().max()) < 1e-7


def test_runge_kutta_has_order_four() -> None:
    x = cloud(2)
    errors = [
        float((advect(swirl, x, [0.0, 1.0], RungeKutta(steps))[-1] - swirled(x, 1.0)).abs().max())
        for steps in (4, 8, 16, 32)
    ]
    orders = [math.log2(a / b) for a, b in pairwise(errors)]
    assert all(3.7 < order < 4.5 for order in orders), orders


def test_forth_and_back_is_where_it_began() -> None:
    x = cloud(2)
    there_and_back = advect(swirl, x, [0.2, 1.0, 0.2], RungeKutta(64))
    assert float((there_and_back[2] - x).abs().max()) < 1e-6
    assert torch.equal(there_and_back[:2], advect(swirl, x, [0.2, 1.0], RungeKutta(64)))


def test_times_on_the_way_cost_no_accuracy() -> None:
    x = cloud(2)
    many = advect(swirl, x, torch.linspace(0, 1, 7), RungeKutta(32))
    assert float((many - torch.stack([swirled(x, t / 6) for t in range(7)])).abs().max()) < 1e-6


def test_chunks_change_nothing_and_progress_counts_them(monkeypatch: pytest.MonkeyPatch) -> None:
    x, told = cloud(2, 50), []
    whole = advect(swirl, x, [0.0, 0.5, 1.0], RungeKutta(4))
    monkeypatch.setattr(advection, "CHUNK", 20)
    parts = advect(swirl, x, [0.0, 0.5, 1.0], RungeKutta(4), progress=lambda done, total: told.append((done, total)))
    torch.testing.assert_close(parts, whole, rtol=0, atol=1e-14)
    assert told == [(done, 12) for done in range(1, 13)]


def test_single_precision_no_points_and_one_time() -> None:
    single = advect(swirl, cloud(2).float(), [0.0, 1.0])
    assert single.dtype == torch.float32
    assert advect(swirl, torch.empty(0, 2), [0.0, 1.0]).shape == (2, 0, 2)
    x = cloud(2)
    assert torch.equal(advect(swirl, x, [0.7]), x[None])
    assert torch.equal(advect(swirl, x, [0.7, 0.7])[1], x)


def test_no_graph_is_kept() -> None:
    x = cloud(2).requires_grad_()
    assert not advect(swirl, x, [0.0, 1.0], RungeKutta(2)).requires_grad


@pytest.mark.parametrize("times", [[], [0.0, math.nan], [math.inf]])
def test_times_must_be_finite(times: list[float]) -> None:
    with pytest.raises(InputError, match="`times` must be finite numbers"):
        advect(swirl, cloud(2), times)


@pytest.mark.parametrize("steps", [0, -1])
def test_the_number_of_steps_must_be_positive(steps: int) -> None:
    with pytest.raises(InputError, match=f"`steps` must be a positive integer, got {steps}"):
        RungeKutta(steps)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("level", [0.0, 0.02])
def test_a_projection_lands_on_the_level(dim: int, level: float) -> None:
    motion = squashed_ball(dim)
    surface = extract_surface(lambda x: motion(x, 0.6), motion.bounds, 24, level).vertices
    x = surface + 0.01 * torch.randn_like(surface)
    projected = LevelProjection(motion, lambda time: level)(x, 0.6)
    assert float((motion(projected, 0.6) - level).abs().max()) < 1e-9
    # the closest points, but for the curvature
    way = projected - x
    gradient = torch.nn.functional.normalize(motion.gradient(projected, 0.6), dim=1)
    along = (way * gradient).sum(1, keepdim=True) * gradient
    assert float((way - along).norm(dim=1).max()) < 0.01


def test_what_cannot_be_projected_stays_and_is_reported() -> None:
    x = torch.tensor([[0.3, 0.0], [0.0, 0.0], [0.9, 0.0], [0.41, 0.0]], dtype=torch.float64)

    def jet(x: Tensor) -> Jet:  # a disk of radius 0.4, whose gradient is not a number in the middle
        norm = x.norm(dim=1)
        return Jet(norm - 0.4, x / norm[:, None])

    points, stayed = project_to_level(jet, x, reach=0.05)
    assert stayed.tolist() == [True, True, True, False]
    assert torch.equal(points[:3], x[:3])
    assert float(points[3, 0]) == pytest.approx(0.4)
    flat, stayed = project_to_level(lambda x: Jet(torch.ones(len(x)).to(x), torch.zeros_like(x)), x)
    assert bool(stayed.all())
    assert torch.equal(flat, x)


def test_projected_points_stay_on_a_surface_that_few_steps_would_lose() -> None:
    motion = squashed_ball(3)
    start = extract_surface(lambda x: motion(x, 0.0), motion.bounds, 16).vertices
    on = LevelProjection(motion)(start, 0.0)
    times, method = [0.0, 0.5, 1.0], RungeKutta(2)
    lost = advect(motion.velocity, on, times, method)
    kept = advect(motion.velocity, on, times, method, LevelProjection(motion))
    off = [float(motion(x, 1.0).abs().max()) for x in (lost[-1], kept[-1])]
    assert off[1] < 1e-9 < 1e-6 < off[0]


@pytest.mark.parametrize("motion", [rotating_box, squashed_box, squashed_ball, translating_ball])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_carried_surface_keeps_its_volume_and_lies_on_the_moving_one(motion: type, dim: int) -> None:
    morph = motion(dim)
    carried = carry_surface(morph, [0.0, 0.5, 1.0], 24)
    volumes = [enclosed_volume(carried.mesh(index)) for index in range(3)]
    assert volumes == pytest.approx([volumes[0]] * 3, rel=1e-7)
    values = torch.stack([morph(x, t) for x, t in zip(carried.vertices, carried.times, strict=True)])
    assert float((values - values[0]).abs().max()) < 1e-7


def test_a_growing_ball_grows() -> None:
    morph = MOTIONS["growing_ball"](3)
    carried = carry_surface(morph, [1.0, 0.0], 24)
    growth = enclosed_volume(carried.mesh(0)) / enclosed_volume(carried.mesh(1))
    assert growth == pytest.approx(morph.volume(1.0) / morph.volume(0.0), rel=0.01)
    assert float(morph(carried.vertices[0], 1.0).abs().max()) < 0.01


def test_a_grown_morph_carries_to_its_wanted_volume() -> None:
    morph = Grown(squashed_ball(3), VolumeLinear(3, 1.0, 1.5))
    carried = carry_surface(morph, [0.0, 1.0], 24)
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
    carried = carry_mesh(squashed_ball(3), TexturedMesh(twice, look), [0.5, 1.0], RungeKutta(8))
    assert carried.times == [0.5, 1.0]
    assert carried.vertices.shape == (2, *twice.vertices.shape)
    assert torch.equal(carried.simplices, twice.simplices)
    assert carried.attributes is look
    assert torch.equal(carried.vertices[:, :50], carried.vertices[:, -50:])
    expected = trajectory(squashed_ball(3), twice.vertices, 1.0)
    assert float((carried.vertices[1] - expected).abs().max()) < 1e-4


def test_correspondences_are_those_of_the_exact_motion() -> None:
    morph = rotating_box(3)
    carried = carry_surface(morph, [0.0, 1.0], 32)
    pairs = correspondences(morph, carried, 32)
    expected = trajectory(morph, pairs.source_points, 1.0)
    cell = 2 / 32
    assert float((pairs.target_points - expected).norm(dim=1).max()) < cell / 2
    torch.testing.assert_close((pairs.target_points - expected).norm(dim=1), pairs.distances, rtol=0, atol=1e-6)
    assert float(pairs.distances.mean()) < 0.05 * cell
    with pytest.raises(InputError, match="give times from 0 to 1"):
        correspondences(morph, carry_surface(morph, [0.0, 0.5], 16), 16)


def test_a_morph_without_velocity_says_so_in_one_sentence() -> None:
    with pytest.raises(InputError, match="has no velocity, so nothing can be carried"):
        carry_surface(shrinking(3, 0.1), [0.0, 1.0], 16)


def test_a_morph_without_surface_at_the_start() -> None:
    morph = translating_ball(2)
    morph.bounds = morph.bounds + 5
    with pytest.raises(InputError, match="no surface at t = 0"):
        carry_surface(morph, [0.0, 1.0], 16)
    empty = SimplexMesh(torch.empty(0, 2), torch.empty(0, 2, dtype=torch.long))
    with pytest.raises(InputError, match="without vertices"):
        carry_mesh(morph, TexturedMesh(empty), [0.0, 1.0])


def test_points_that_lose_the_surface_are_reported(caplog: pytest.LogCaptureFixture) -> None:
    far = SimplexMesh(torch.tensor([[0.9, 0.9], [0.8, 0.9]], dtype=torch.float64), torch.tensor([[0, 1]]))
    morph = translating_ball(2)
    with caplog.at_level(logging.WARNING):
        carried = carry_mesh(morph, TexturedMesh(far), [0.0, 1.0], project=LevelProjection(morph))
    assert "66 of 66 moves to the surface" in caplog.text
    torch.testing.assert_close(carried.vertices[1], trajectory(morph, far.vertices, 1.0))


def textured_obj(folder: Path) -> Path:
    """A square of two triangles with a texture; the corner at the origin has two places on the picture."""
    Image.new("RGB", (4, 4), (255, 128, 0)).save(folder / "skin.png")
    (folder / "skin.mtl").write_text("newmtl skin\nKd 1 1 1\nmap_Kd skin.png\n")
    lines = ["mtllib skin.mtl", "usemtl skin", "v 0 0 0", "v 1 0 0", "v 1 1 0", "v 0 1 0"]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "vt 0.5 0.5", "f 1/1 2/2 3/3", "f 1/5 3/3 4/4"]
    (folder / "square.obj").write_text("\n".join(lines) + "\n")
    return folder / "square.obj"


def test_an_obj_keeps_its_texture_and_its_seams(tmp_path: Path) -> None:
    mesh, look = load_textured(textured_obj(tmp_path))
    assert look.colors is None
    assert look.uv is not None
    assert look.texture is not None
    assert look.uv.shape == (len(mesh.vertices), 2)
    assert look.texture.size == (4, 4)
    assert look.texture.convert("RGB").getpixel((0, 0)) == (255, 128, 0)
    corners = {
        (tuple(place), tuple(uv))
        for place, uv in zip(
            mesh.vertices[mesh.simplices.flatten()].tolist(), look.uv[mesh.simplices.flatten()].tolist(), strict=True
        )
    }
    assert corners == {
        ((0, 0, 0), (0, 0)),
        ((1, 0, 0), (1, 0)),
        ((1, 1, 0), (1, 1)),
        ((0, 1, 0), (0, 1)),
        ((0, 0, 0), (0.5, 0.5)),
    }


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_a_ply_keeps_its_colors_and_values(tmp_path: Path, encoding: str) -> None:
    ball = trimesh.creation.icosphere(2)
    colors = np.random.default_rng(0).integers(0, 256, (len(ball.vertices), 4), dtype=np.uint8)
    ball.visual.vertex_colors = colors
    ball.vertex_attributes["weight"] = np.arange(len(ball.vertices), dtype=np.float32)
    ball.export(tmp_path / "ball.ply", encoding=encoding)
    mesh, look = load_textured(tmp_path / "ball.ply")
    assert torch.equal(mesh.simplices, torch.tensor(np.asarray(ball.faces)))
    torch.testing.assert_close(mesh.vertices, torch.tensor(np.asarray(ball.vertices)), rtol=0, atol=1e-6)
    assert look.colors is not None
    assert torch.equal((255 * look.colors).round(), torch.tensor(colors[:, :3]).double())
    assert set(look.others) == {"weight"}
    assert look.others["weight"].flatten().tolist() == list(range(len(ball.vertices)))


def test_a_bare_mesh_has_no_look_and_a_missing_file_a_sentence(tmp_path: Path) -> None:
    trimesh.creation.icosphere(1).export(tmp_path / "ball.stl")
    assert load_textured(tmp_path / "ball.stl").attributes[:3] == (None, None, None)
    with pytest.raises(InputError):
        load_textured(tmp_path / "nothing.obj")


def test_a_mesh_is_placed_where_the_source_lies(caplog: pytest.LogCaptureFixture) -> None:
    source = Ball(0.5, [3.0, 0.0, 0.0], pose={"translation": [-3.0, 0.0, 0.0]})
    field = shrinking(3, 0.1).field
    morph = NeuralMorph(field, None, source, source)
    mesh = TexturedMesh(SimplexMesh(torch.tensor([[3.5, 0, 0], [3, 0.5, 0], [3, 0, 0.5]]), torch.tensor([[0, 1, 2]])))
    with caplog.at_level(logging.WARNING):
        there = placed(morph, mesh)
    torch.testing.assert_close(there.mesh.vertices, torch.eye(3) / 2)
    assert "from the surface at t = 0" in caplog.text  # for f is no ball of that radius
    with pytest.raises(InputError, match="knows no coordinates"):
        placed(rotating_box(3), mesh)


def test_a_published_mesh_lies_on_its_network_wherever_that_is_posed(data_dir: Path) -> None:
    pose = {"rotation": [0, 30, 0], "scale": 0.7, "translation": [0.1, 0, 0]}
    source = SirenFile(str(data_dir / "official" / "ni" / "cylinder.pth"), pose=pose)
    mesh = load_textured(data_dir / "official" / "meshes" / "cylinder.ply")
    vertices = placed(NeuralMorph(shrinking(3, 0.1).field, None, source, source), mesh).mesh.vertices
    assert float(source(vertices[::20]).abs().mean()) < 0.005
