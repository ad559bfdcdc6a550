"""What validation sees of a morph: leftovers, components, drift, thin shapes, and where the shape moves to."""

from __future__ import annotations

import logging
import math

import pytest
import torch
from torch import Tensor

from nsm.fields import ScalarNetwork
from nsm.geometry.band import sample_band
from nsm.geometry.grid import Lattice
from nsm.geometry.meshing import extract_surface, surface_in_band
from nsm.geometry.topology import component_volumes, enclosed_volume
from nsm.geometry.volume import volume_in_surface
from nsm.metrics.pieces import LEAST_SHARE, Pieces
from nsm.morphs.neural import NeuralMorph
from nsm.shapes import Ball, Box
from nsm.train.tasks.validation import Validation, Validator, look_at
from nsm.types import Jet

#: Cells along a training box of ±1.5.
RESOLUTION = 48


class Balls(ScalarNetwork):
    """The exact distance of balls that move evenly: each has a radius, a start and an end."""

    hidden_features = hidden_layers = 1

    def __init__(self, *balls: tuple[float, list[float], list[float]]) -> None:
        super().__init__()
        self.balls, self.in_features = balls, len(balls[0][1]) + 1

    def forward(self, x: Tensor) -> Tensor:
        space, t = x[:, :-1], x[:, -1:]
        ways = [(radius, torch.tensor(start), torch.tensor(end)) for radius, start, end in self.balls]
        return torch.stack([(space - (1 - t) * a - t * b).norm(dim=1) - r for r, a, b in ways]).amin(0)

    def jet(self, x: Tensor) -> Jet:
        with torch.enable_grad():
            x = x.detach().requires_grad_()
            value = self(x)
            (gradient,) = torch.autograd.grad(value.sum(), x)
        return Jet(value.detach(), gradient)


class Sliding(Balls):
    """A box of given sides that slides along the last axis from 0 to a place; a distance near its faces."""

    def __init__(self, sides: list[float], way: float) -> None:
        super().__init__((0.0, [0.0] * len(sides), [0.0] * len(sides)))
        self.box, self.way = Box(sides, [0.0] * len(sides)), way

    def forward(self, x: Tensor) -> Tensor:
        shift = torch.zeros(len(x), len(x[0]) - 1)
        shift[:, -1] = self.way
        return self.box(x[:, :-1] - x[:, -1:] * shift)


def validated(morph: NeuralMorph, half_width: float = 1.5, times: int = 3) -> Validation:
    return Validator(morph, half_width, RESOLUTION, times).validate(0)


def still(*balls: tuple[float, list[float]], radius: float = 0.5) -> NeuralMorph:
    """Balls that stay where they are, between two balls at the origin."""
    dim = len(balls[0][1])
    ends = Ball(radius, [0.0] * dim), Ball(radius, [0.0] * dim)
    return NeuralMorph(Balls(*((r, place, place) for r, place in balls)), None, *ends)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_volume_in_a_mesh_is_corrected_by_the_field(dim: int) -> None:
    """An order more than the mesh itself: halving the cells leaves a sixteenth of the error, not a quarter."""
    ball = Ball(0.6, [0.013, 0.021, 0.034][:dim])
    field = lambda x: 0.8 * ball(x)  # noqa: E731 (its slope must not matter)
    box = torch.tensor([[-1.0] * dim, [1.0] * dim], dtype=torch.double)
    errors, of_meshes = [], []
    for resolution in (16, 32):
        mesh = surface_in_band(sample_band(field, Lattice.corners(box, resolution)))
        errors.append(abs(volume_in_surface(mesh, field) / ball.volume() - 1))
        of_meshes.append(abs(enclosed_volume(mesh) / ball.volume() - 1))
    assert errors[0] < 0.1 * of_meshes[0]
    assert errors[1] < errors[0] / 8
    assert errors[1] < 1e-4


def test_components_enclose_what_they_are_and_hollows_count_against() -> None:
    box = torch.tensor([[-1.0] * 3, [1.0] * 3])

    def field(x: Tensor) -> Tensor:
        shell = torch.maximum(Ball(0.5)(x - torch.tensor([-0.3, 0.0, 0.0])), -Ball(0.3)(x - torch.tensor([-0.3, 0, 0])))
        return torch.minimum(shell, Ball(0.2)(x - torch.tensor([0.6, 0.0, 0.0])))

    volumes = component_volumes(extract_surface(field, box, 64)).sort().values
    balls = torch.tensor([-(0.3**3), 0.2**3, 0.5**3], dtype=torch.double) * 4 / 3 * math.pi
    torch.testing.assert_close(volumes, balls, rtol=0.02, atol=0)


def test_a_morph_that_is_its_end_shapes_has_no_error() -> None:
    found = validated(still((0.5, [0.0, 0.0, 0.0])))
    assert found.morph_to_shape < 1e-5
    assert found.drift < 1e-5
    assert found.components == 1
    assert found.leftover == (0.0, 0.0)
    assert found.beyond == 0


@pytest.mark.parametrize(("radii", "wanted"), [((0.4, 0.6), 0.0), ((0.4, 0.4), 0.5**2 / 0.4**2 - 1)])
def test_only_shapes_of_one_volume_want_it_in_between(radii: tuple[float, float], wanted: float) -> None:
    """Disks of different areas are reached by any course; of one area, r = 0.5 halfway is as far off as its area."""

    class Swelling(Balls):
        def forward(self, x: Tensor) -> Tensor:
            t, (start, end) = x[:, -1], radii
            return x[:, :-1].norm(dim=1) - (start + (end - start) * t + 4 * (0.5 - (start + end) / 2) * t * (1 - t))

    morph = NeuralMorph(Swelling((0.0, [0.0, 0.0], [0.0, 0.0])), None, *(Ball(r, [0.0, 0.0]) for r in radii))
    found = validated(morph)
    assert found.volume_error < 1e-3
    assert found.volume_max == pytest.approx(max(0.5, radii[1]) ** 2 / 0.4**2 - 1, rel=1e-2)
    assert found.drift == pytest.approx(wanted * math.sqrt(math.pi * 0.4**2) / 2, abs=1e-3)


def test_a_leftover_is_seen_from_the_morph() -> None:
    """f keeps a second ball: every point of the end shapes lies on f's surface, so only looking back sees it."""
    radius, place = 0.1, [0.9, 0.0, 0.0]
    morph = still((0.5, [0.0, 0.0, 0.0]), (radius, place))
    found = validated(morph)
    share = radius**2 / (radius**2 + 0.5**2)
    assert found.morph_to_shape == pytest.approx(share * 0.4, rel=0.1)
    assert found.components == 2
    assert found.leftover.share == pytest.approx(radius**3 / 0.5**3, rel=0.25)
    assert found.leftover.distance == pytest.approx(math.sqrt(share) * 0.4, rel=0.1)


def test_a_speck_between_the_ends_is_seen_where_both_ends_are_right() -> None:
    class Flash(Balls):
        def forward(self, x: Tensor) -> Tensor:
            away = (x[:, :-1] - torch.tensor([0.8, 0.0, 0.0])).norm(dim=1)
            return torch.minimum(super().forward(x), away - 0.08 + 2 * (x[:, -1] - 0.5).abs())

    origin = [0.0, 0.0, 0.0]
    morph = NeuralMorph(Flash((0.5, origin, origin)), None, Ball(0.5), Ball(0.5))
    found = validated(morph)
    assert found.components == 2
    assert found.leftover.distance > 1e-3
    assert found.morph_to_shape < 1e-4
    assert validated(morph, times=2).components == 1


def test_pieces_that_an_end_shape_has_are_no_leftovers() -> None:
    two = [(0.3, [-0.5, 0.0, 0.0], [-0.2, 0.0, 0.0]), (0.3, [0.5, 0.0, 0.0], [0.2, 0.0, 0.0])]

    class Pair(Ball):
        def forward(self, x: Tensor) -> Tensor:
            return Balls(*two)(torch.cat([x, torch.zeros(len(x), 1)], 1))

        def volume(self) -> float:
            return 2 * super().volume()

    morph = NeuralMorph(Balls(*two), None, Pair(0.3), Ball(0.3))
    found = validated(morph)
    assert found.components == 2
    assert found.leftover == (0.0, 0.0)


def test_a_component_below_the_least_share_is_no_component() -> None:
    radius = 0.5 * (0.5 * LEAST_SHARE) ** (1 / 3)
    field = lambda x: torch.minimum(Ball(0.5)(x), Ball(radius, [0.7, 0.0, 0.0])(x))  # noqa: E731
    corner = torch.tensor([0.68, -0.02, -0.02])
    mesh = extract_surface(field, torch.stack([-torch.ones(3), torch.ones(3)]), 200)
    assert len(component_volumes(mesh)) == 2, "the speck must be in the mesh"
    assert Pieces.of(mesh).components == 1
    assert Pieces.of(extract_surface(field, torch.stack([corner, corner + 0.04]), 16)).components == 1


@pytest.mark.parametrize("place", [0.0, 0.013])
def test_a_plate_of_thickness_a_fiftieth_is_measured_wherever_it_lies(place: float) -> None:
    """Cells of 1/32 lose all of it where it falls between them."""
    sides = [0.6, 0.6, 0.02]
    shape = Box(sides, [0.0, 0.0, place])
    morph = NeuralMorph(Sliding(sides, 0.1), None, Box(sides), Box(sides, [0.0, 0.0, 0.1]))
    validator = Validator(morph, 1.5, RESOLUTION, 2)
    assert validator.resolution > 3.0 / 0.02
    assert look_at(shape, validator.box, validator.resolution).volume == pytest.approx(math.prod(sides), rel=0.03)
    found = validator.validate(0)
    assert found.volume_max < 0.03
    assert found.volume_error < 0.03
    assert found.components == 1


def test_a_thin_fin_on_a_thick_body_is_not_overlooked() -> None:
    """Two grids miss the fin and agree on the body, whose volume is not all of it."""
    fin, body = [0.9, 0.9, 0.02], Ball(0.2)

    class Winged(Ball):
        def forward(self, x: Tensor) -> Tensor:
            return torch.minimum(super().forward(x), Box(fin, [0.0, 0.0, 0.313])(x))

        def volume(self) -> float:
            return super().volume() + math.prod(fin)

    validator = Validator(NeuralMorph(Balls((0.2, [0.0] * 3, [0.0] * 3)), None, Winged(0.2), body), 1.5, RESOLUTION, 2)
    assert float(validator.key_volumes[0]) == pytest.approx(body.volume() + math.prod(fin), rel=0.03)


def test_a_volume_that_no_grid_confirms_costs_no_finer_one() -> None:
    class Boasting(Ball):
        def volume(self) -> float:
            return 2 * super().volume()

    validator = Validator(still((0.5, [0.0, 0.0, 0.0])), 1.5, RESOLUTION, 2)
    validator.morph.source = Boasting(0.5)
    assert validator.resolution == RESOLUTION


def test_a_shape_that_no_grid_resolves_leaves_a_finite_error_and_a_sentence(caplog: pytest.LogCaptureFixture) -> None:
    sides = [1.0, 0.002]
    morph = NeuralMorph(Sliding(sides, 0.31), None, Box(sides, [0.0, 0.0]), Box(sides, [0.0, 0.31]))
    with caplog.at_level(logging.WARNING):
        found = validated(morph)
    assert "A shape is so thin that" in caplog.text
    assert all(math.isfinite(value) for value in (found.drift, found.volume_std, found.morph_to_shape))


def test_no_surface_is_a_finite_error_and_a_sentence(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        found = validated(still((-0.2, [0.0, 0.0, 0.0])))
    assert "has no surface at t = 0 and t = 1 yet" in caplog.text
    assert found.volume_max == found.volume_error == 1
    assert found.morph_to_shape == pytest.approx(3 * math.sqrt(3))
    assert math.isfinite(found.drift + found.volume_std)


def test_the_box_contains_a_shape_that_leaves_the_unit_box_on_its_way() -> None:
    """It goes out to 1.2 in x and comes back: volume inside ±1 alone would say that half of it is lost."""

    class Detour(Balls):
        def forward(self, x: Tensor) -> Tensor:
            way = 4 * x[:, -1] * (1 - x[:, -1])
            middle = torch.stack([way, 0 * way, 0 * way], 1)
            return (x[:, :-1] - middle).norm(dim=1) - 0.2

    origin = [0.0, 0.0, 0.0]
    morph = NeuralMorph(Detour((0.2, origin, origin)), None, Ball(0.2), Ball(0.2))
    found = validated(morph)
    assert found.volume_max < 1e-3
    low, high = found.box.tolist()
    assert 1.2 < high[0] < 1.2 + 5 * 3 / RESOLUTION
    assert -0.2 - 5 * 3 / RESOLUTION < low[0] < -0.2
    assert high[1] < 0.2 + 5 * 3 / RESOLUTION, "a box need not be a cube"


def test_the_box_holds_far_blobs_and_both_end_shapes() -> None:
    found = validated(still((0.1, [1.3, 0.0]), (0.2, [0.0, 0.0]), radius=0.6))
    assert found.box[1, 0] > 1.4
    assert found.box[0, 1] < -0.6
    assert found.leftover.share > 0


def test_what_leaves_the_training_box_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    """Half of the ball at t = 1 lies beyond the box."""
    origin, rim = [0.0, 0.0, 0.0], [1.5, 0.0, 0.0]
    morph = NeuralMorph(Balls((0.3, origin, rim)), None, Ball(0.3), Ball(0.3, [0.7, 0.0, 0.0]))
    with caplog.at_level(logging.WARNING):
        found = validated(morph)
    assert found.beyond == pytest.approx(0.5, rel=0.1)
    assert "leaves the training box [-1.5, 1.5]^3 at t = 1, with about" in caplog.text
    assert "Try a larger `sampler.box.half_width`." in caplog.text
    assert float(found.box[1, 0]) == 1.5
