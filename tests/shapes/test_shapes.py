"""Shapes by formula: exact distances, volumes and bounds, poses, equal volumes, and what each refuses."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
from hydra.utils import instantiate
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.sampling import sample_mesh
from nsm.shapes import (
    Ball,
    Box,
    Capsule,
    Cylinder,
    FieldShape,
    Polygon,
    Primitive,
    Similarity,
    Torus,
    Union,
    equal_volume,
    place_together,
)
from nsm.types import SimplexMesh

TILTED = {"rotation": [20, -35, 50], "translation": [0.1, -0.05, 0.08], "scale": 0.8}
TURNED = {"rotation": 25, "translation": [0.1, -0.05], "scale": 0.8}
ARROW = [[-0.6, -0.5], [0, -0.2], [0.6, -0.5], [0, 0.7]]

MAKERS: dict[str, Callable[[], Primitive]] = {
    "ball": lambda: Ball(0.5, [0.1, 0, 0.2], TILTED),
    "disk": lambda: Ball(0.3, [-0.5, 0], TURNED),
    "box": lambda: Box([0.6, 0.4, 0.9], [0.1, 0, 0], TILTED),
    "rectangle": lambda: Box([0.9, 0.3], [0, 0.1], TURNED),
    "cylinder": lambda: Cylinder(0.3, 0.8, [0.1, 0.2, 0], TILTED),
    "capsule": lambda: Capsule(0.2, 0.6, [0, 0, 0.1], TILTED),
    "stadium": lambda: Capsule(0.2, 0.6, [0, 0.1], TURNED),
    "torus": lambda: Torus(0.4, 0.15, [0, 0.1, 0], TILTED),
    "polygon": lambda: Polygon(ARROW, TURNED),
    "polygon clockwise": lambda: Polygon(ARROW[::-1]),
    "two cylinders": lambda: Union([Cylinder(0.2, 0.6, [-0.5, 0, 0]), Cylinder(0.2, 0.6, [0.5, 0, 0])], TILTED),
}


@pytest.fixture(params=MAKERS)
def shape(request: pytest.FixtureRequest) -> Primitive:
    return MAKERS[request.param]()


def _cube(count: int, dim: int, generator: torch.Generator) -> Tensor:
    return 2 * torch.rand(count, dim, generator=generator, dtype=torch.float64) - 1


def test_the_distance_is_that_to_the_nearest_point_of_the_surface(shape: Primitive, generator: torch.Generator) -> None:
    # A dense cloud on the zero level is never nearer than the surface, and hardly farther.
    cloud = shape.surface_samples(60000, generator).points.double()
    x = _cube(400, shape.dim, generator)
    excess = torch.cdist(x, cloud).amin(1) - shape(x).abs()
    assert excess.min() > -1e-5
    assert excess.max() < 0.02
    assert excess.mean() < 1.5e-3


def test_the_sign_is_that_of_the_winding_number_of_the_surface(shape: Primitive, generator: torch.Generator) -> None:
    samples = shape.surface_samples(20000, generator)
    assert (shape(samples.points + 1e-3 * samples.normals) > 0).double().mean() > 0.999
    assert (shape(samples.points - 1e-3 * samples.normals) < 0).double().mean() > 0.999


def test_the_gradient_has_length_one_almost_everywhere(shape: Primitive, generator: torch.Generator) -> None:
    norms = shape.jet(_cube(2000, shape.dim, generator)).gradient.norm(dim=1)
    assert ((norms - 1).abs() < 1e-9).double().mean() > 0.999


def test_the_jet_can_be_differentiated_once_more() -> None:
    x = torch.tensor([[0.3, 0.4, 0.0]], dtype=torch.float64, requires_grad=True)
    gradient = Ball(0.5).jet(x).gradient
    (second,) = torch.autograd.grad(gradient[0, 0], x)
    torch.testing.assert_close(second, torch.tensor([[1.28, -0.96, 0.0]], dtype=torch.float64))


def test_closed_forms_of_volume_and_bounds_agree_with_the_grid(shape: Primitive) -> None:
    assert FieldShape.volume(shape) == pytest.approx(shape.volume(), rel=1e-3)
    torch.testing.assert_close(FieldShape.bounds(shape), shape.bounds(), atol=1e-2, rtol=0)


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (Ball(0.5), math.pi / 6),
        (Ball(0.5, [0, 0]), math.pi / 4),
        (Box([0.5, 0.6, 0.7]), 0.21),
        (Cylinder(0.5, 1), math.pi / 4),
        (Capsule(0.5, 0.4), math.pi / 6 + 0.1 * math.pi),
        (Torus(0.5, 0.2), 2 * math.pi**2 * 0.5 * 0.04),
        (Polygon([[0, 0], [1, 0], [0, 1]]), 0.5),
        (Union([Ball(0.2, [-0.5, 0, 0]), Ball(0.2, [0.5, 0, 0])]), 8 / 3 * math.pi * 0.008),
        (Ball(0.5, pose={"scale": 0.5}), math.pi / 48),
    ],
)
def test_volumes(shape: Primitive, volume: float) -> None:
    assert shape.volume() == pytest.approx(volume, rel=1e-12)


def test_the_volume_of_overlapping_members_is_counted_once() -> None:
    twice = Union([Ball(0.5, [0, 0, 0]), Ball(0.5, [0, 0, 0])])
    assert twice.volume() == pytest.approx(math.pi / 6, rel=1e-4)


def test_surface_samples_lie_on_the_surface_spread_by_area(generator: torch.Generator) -> None:
    samples = Torus(0.5, 0.2).surface_samples(20000, generator)
    assert Torus(0.5, 0.2)(samples.points).abs().max() < 1e-6
    # Pappus: the half of the tube outside the ring of its middle has 1/2 + r/(π R) of the area.
    outer = (samples.points[:, :2].norm(dim=1) > 0.5).double().mean()
    assert float(outer) == pytest.approx(0.5 + 0.2 / (math.pi * 0.5), abs=0.012)
    torch.testing.assert_close(samples.normals.norm(dim=1), torch.ones(20000))


def test_points_on_a_mesh_are_uniform_in_each_simplex(generator: torch.Generator) -> None:
    for vertices in ([[0.0, 0], [1, 2]], [[0.0, 0, 0], [1, 0, 0], [0, 1, 3]]):
        corners = torch.tensor(vertices, dtype=torch.float64)
        mesh = SimplexMesh(corners, torch.arange(len(corners))[None])
        points, chosen = sample_mesh(mesh, 40000, generator)
        assert not chosen.any()
        torch.testing.assert_close(points.mean(0), corners.mean(0), atol=0.02, rtol=0)
        k = len(corners)  # the covariance of the uniform distribution on a simplex
        covariance = torch.cov(corners.T, correction=0) / (k + 1)
        torch.testing.assert_close(torch.cov(points.T), covariance, atol=0.02, rtol=0)


def test_distance_samples_are_half_uniform_and_half_near(shape: Primitive, generator: torch.Generator) -> None:
    bounds = torch.tensor([[-1.5] * shape.dim, [1.5] * shape.dim])
    samples = shape.distance_samples(4000, generator, bounds)
    assert samples.points.shape == (4000, shape.dim)
    torch.testing.assert_close(samples.distances, shape(samples.points))
    uniform, near = samples.points[:2000], samples.distances[2000:]
    assert uniform.abs().max() > 1.45
    assert near.abs().mean() < 0.05


def test_samples_follow_the_generator(shape: Primitive) -> None:
    first, again, other = (shape.distance_samples(100, torch.Generator().manual_seed(s)).points for s in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_a_shape_comes_back_from_its_config(shape: Primitive, generator: torch.Generator) -> None:
    again = instantiate(shape.config())
    again.load_state_dict(shape.state_dict())
    x = _cube(500, shape.dim, generator)
    assert torch.equal(again(x), shape(x))


def test_a_moved_shape_is_the_formula_of_the_move(shape: Primitive, generator: torch.Generator) -> None:
    move = Similarity.read({"rotation": 40 if shape.dim == 2 else [10, 20, 30], "scale": 0.7}, shape.dim)
    x = _cube(500, shape.dim, generator)
    expected = 0.7 * shape(x @ move.rotation / 0.7)
    torch.testing.assert_close(shape.transformed(move)(x), expected, atol=1e-12, rtol=0)
    assert shape.transformed(move).volume() == pytest.approx(0.7**shape.dim * shape.volume(), rel=1e-12)


def test_similarities_form_a_group(generator: torch.Generator) -> None:
    for dim, pose in ((3, TILTED), (2, TURNED)):
        a = Similarity.read(pose, dim)
        b = Similarity.read({"rotation": 70 if dim == 2 else [0, 0, 70], "scale": 1.3}, dim)
        x = _cube(50, dim, generator)
        torch.testing.assert_close(a.after(b).apply(x), a.apply(b.apply(x)), atol=1e-12, rtol=0)
        torch.testing.assert_close(a.inverse().apply(a.apply(x)), x, atol=1e-12, rtol=0)
        torch.testing.assert_close(a.pull_back(a.apply(x)), x, atol=1e-12, rtol=0)
        torch.testing.assert_close(a.rotation.det(), torch.tensor(1.0, dtype=torch.float64))
        again = Similarity.read(a.to_config(), dim)
        assert torch.equal(again.rotation, a.rotation)
        assert torch.equal(again.translation, a.translation)
        assert again.scale == a.scale


def test_rotations_turn_counterclockwise_in_degrees() -> None:
    x, y = torch.eye(3, dtype=torch.float64)[:2]
    torch.testing.assert_close(Similarity.read({"rotation": [0, 0, 90]}, 3).apply(x[None])[0], y, atol=1e-9, rtol=0)
    torch.testing.assert_close(Similarity.read({"rotation": 90}, 2).apply(x[None, :2])[0], y[:2], atol=1e-9, rtol=0)


def test_provenance_takes_points_back(shape: Primitive, generator: torch.Generator) -> None:
    similarity = Similarity.read(shape.provenance()["similarity"], shape.dim)
    x = _cube(200, shape.dim, generator)
    own = shape.local_distance(similarity.inverse().apply(x))
    torch.testing.assert_close(similarity.scale * own, shape(x), atol=1e-12, rtol=0)


def test_equal_volume_scales_the_larger_one_down() -> None:
    result = equal_volume(Ball(0.6), Box([0.5, 0.5, 0.5]))
    assert [shape.volume() for shape in result.shapes] == pytest.approx([0.125, 0.125], rel=1e-12)
    assert result.scales[1] == 1
    assert result.scales[0] == pytest.approx((0.125 / (4 / 3 * math.pi * 0.6**3)) ** (1 / 3), rel=1e-12)
    flat = equal_volume(Ball(0.2, [0, 0]), Box([0.5, 0.5], [0, 0]))
    assert flat.scales[1] == pytest.approx(math.sqrt(math.pi * 0.04 / 0.25), rel=1e-12)
    assert flat.shapes[1].volume() == pytest.approx(flat.shapes[0].volume(), rel=1e-12)
    three = equal_volume(Ball(0.6), Box([0.5, 0.5, 0.5]), Ball(0.2))
    assert [shape.volume() for shape in three.shapes] == pytest.approx([Ball(0.2).volume()] * 3, rel=1e-12)
    assert three.scales == (pytest.approx(1 / 3), pytest.approx((Ball(0.2).volume() / 0.125) ** (1 / 3)), 1)


def test_each_shape_is_scaled_about_its_own_center() -> None:
    result = equal_volume(Ball(0.6, [0.3, 0.2, 0]), Ball(0.3, [-0.4, 0, 0]))
    torch.testing.assert_close(result.shapes[0].bounds().mean(0), torch.tensor([0.3, 0.2, 0]))
    assert result.scales[0] == pytest.approx(0.5)


def test_a_pair_fills_the_box_together_and_keeps_its_relative_place() -> None:
    source, target = Ball(0.3, [5.0, 0, 1]), Box([2, 1, 1], [8, 0, 1])
    pair = place_together(source, target)
    boxes = torch.stack([shape.exact_bounds() for shape in pair.shapes])
    low, high = boxes[:, 0].amin(0), boxes[:, 1].amax(0)
    torch.testing.assert_close(low, -high, atol=1e-12, rtol=0)
    assert float((high - low).max()) == pytest.approx(1.8, rel=1e-12)
    scale = 1.8 / 4.3
    assert pair.similarity.scale == pytest.approx(scale, rel=1e-12)
    apart = (boxes[1] - boxes[0]).mean(0)
    torch.testing.assert_close(apart, torch.tensor([3 * scale, 0, 0], dtype=torch.float64), atol=1e-12, rtol=0)
    back = pair.shapes[0].similarity.inverse().apply(torch.zeros(1, 3, dtype=torch.float64))
    torch.testing.assert_close(back, torch.tensor([[6.85, 0, 1]], dtype=torch.float64), atol=1e-12, rtol=0)
    assert pair.shapes[0].volume() == pytest.approx(source.volume() * scale**3)


def test_a_plate_and_a_ball_fill_the_box() -> None:
    plate, ball = Box([1.6, 1.6, 0.02]), Ball(0.5)
    ends = equal_volume(plate, ball)
    source, target = place_together(*ends.shapes).shapes
    assert source.volume() == pytest.approx(target.volume(), rel=1e-9)
    torch.testing.assert_close(source.bounds()[1], torch.tensor([0.9, 0.9, 0.01125]))
    assert float(target.bounds()[1, 0]) == pytest.approx(0.2303 * 0.9 / 0.8, rel=1e-3)


def test_the_default_pair_has_equal_volumes() -> None:
    cylinders = Union([Cylinder(math.sqrt(1 / 40), 2 / 3, [c, 0, 0]) for c in (-0.5, 0.5)])
    torus = Torus(1 / 3, math.sqrt(1 / (20 * math.pi)))
    assert cylinders.volume() == pytest.approx(math.pi / 30, rel=1e-12)
    assert torus.volume() == pytest.approx(math.pi / 30, rel=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Ball(0), "`radius` must be positive and finite, got 0"),
        (lambda: Ball(-0.1), "Try `radius=0.5`"),
        (lambda: Ball(float("nan")), "`radius` must be positive and finite, got nan"),
        (lambda: Ball(0.5, [0.0]), "2 or 3 coordinates, got 1"),
        (lambda: Box([0.5, 0, 0.5]), "`size` must be positive and finite, got 0"),
        (lambda: Box([0.5, 0.5], [0, 0, 0]), "must have the same dimension, got 2 and 3 numbers"),
        (lambda: Cylinder(0.2, 0.4, [0, 0]), "3 coordinates for this shape, got 2"),
        (lambda: Torus(0.2, 0.3), "`minor` must be less than `major`"),
        (lambda: Polygon([[0, 0], [1, 1], [0.5, 0.5]]), "must not be collinear"),
        (lambda: Polygon([[0, 0], [1, 1]]), "at least three points"),
        (lambda: Union([]), r"got dimensions \[\]"),
        (lambda: Union([Ball(0.2), Ball(0.2, [0, 0])]), r"got dimensions \[2, 3\]"),
        (lambda: Ball(0.5, pose={"rotation": 30}), "three numbers, the axis times the angle"),
        (lambda: Ball(0.5, [0, 0], pose={"rotation": [1, 2, 3]}), "one angle in degrees"),
        (lambda: Ball(0.5, pose={"translation": [0.1]}), "`pose.translation` must be 3 finite numbers"),
        (lambda: Ball(0.5, pose={"scale": 0}), "`pose.scale` must be positive and finite, got 0"),
        (lambda: Ball(0.5, pose={"turn": 0}), "got 'turn'"),
        (lambda: Ball(0.5, pose={"rotation": [[1, 0, 0], [0, 2, 0], [0, 0, 1]]}), "which is not a rotation"),
        (lambda: Ball(0.5, pose={"rotation": ["a", "b", "c"]}), "must consist of numbers"),
        (lambda: equal_volume(Ball(0.2), Ball(0.2, [0, 0])), r"the dimension of the first, 3D, got a ball in 2D"),
    ],
)
def test_invalid_shapes_are_rejected(make: Callable[[], object], words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        make()
    assert "\n" not in str(error.value)
