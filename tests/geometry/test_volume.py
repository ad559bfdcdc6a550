"""Volumes and areas against closed forms, and their orders of convergence."""

from __future__ import annotations

import math

import pytest
import torch
from problems import MOTIONS, Ball, Box

from nsm.geometry.band import sample_band
from nsm.geometry.grid import Lattice
from nsm.geometry.volume import cell_fraction, volume, volume_in_band, volume_with_error

CUBE = torch.tensor([[-1.0] * 3, [1.0] * 3], dtype=torch.float64)
SQUARE = CUBE[:, :2]
#: Off every symmetry of the grid.
SHIFT = torch.tensor([0.0131, -0.0473, 0.0297], dtype=torch.float64)
TURN = torch.matrix_exp(torch.tensor([[0, 0.3, 0.7], [-0.3, 0, -0.4], [-0.7, 0.4, 0]], dtype=torch.float64))
TURN_2D = torch.matrix_exp(torch.tensor([[0, 0.4], [-0.4, 0]], dtype=torch.float64))


def ball(x, radius=0.5):
    return Ball(x.shape[1], radius).jet(x).value


def torus(x):
    return torch.stack([x[:, :2].norm(dim=1) - 0.5, x[:, 2]], 1).norm(dim=1) - 0.2


def triangle(x):
    """The greatest of the distances to three lines: a triangle with a base of 1.5 and a height of 0.72."""
    normals = torch.tensor([[0.0, -1.0], [0.8, 0.6], [-0.6, 0.8]], dtype=x.dtype)
    return (x @ normals.T - x.new_tensor([0.3, 0.3, 0.3])).amax(1)


def relative_error(field, bounds, resolution, exact):
    return abs(volume(field, bounds, resolution) / exact - 1)


def test_ball_of_radius_one_half_at_64():
    assert relative_error(ball, CUBE, 64, math.pi / 6) < 2e-5
    assert relative_error(lambda x: ball(x - SHIFT), CUBE, 64, math.pi / 6) < 2e-5
    assert relative_error(ball, CUBE.float(), 64, math.pi / 6) < 2e-5


def test_disk_at_64():
    assert relative_error(ball, SQUARE, 64, math.pi / 4) < 1e-4


@pytest.mark.parametrize(
    "field",
    [
        lambda x: x.square().sum(1) - 0.25,
        lambda x: 7 * ball(x),
        lambda x: torch.expm1(2 * ball(x)),
        lambda x: ball(x) * (0.4 + x[:, 0].square()),
        lambda x: ball(x).clamp(-0.2, 0.2),
    ],
)
def test_only_the_zero_set_counts(field):
    assert relative_error(field, CUBE, 64, math.pi / 6) < 1e-4


@pytest.mark.parametrize(
    ("field", "bounds", "exact", "tolerance"),
    [
        (torus, CUBE, 2 * math.pi**2 * 0.5 * 0.2**2, 1e-4),
        (lambda x: Box((0.5, 0.3, 0.4)).jet(x).value, CUBE, 0.48, 1e-3),
        (lambda x: Box((0.5, 0.3, 0.4)).jet(x @ TURN).value, CUBE, 0.48, 2e-4),
        (lambda x: Box((0.5, 0.31)).jet(x).value, SQUARE, 0.62, 1e-3),
        (lambda x: Box((0.5, 0.31)).jet(x @ TURN_2D).value, SQUARE, 0.62, 1e-3),
        (triangle, SQUARE, 0.54, 2e-3),
    ],
    ids=["torus", "box", "turned box", "rectangle", "turned rectangle", "triangle"],
)
def test_other_shapes(field, bounds, exact, tolerance):
    assert relative_error(field, bounds, 64, exact) < tolerance


def test_smooth_shapes_converge_with_fourth_order():
    def mean_error(resolution):
        shifts = torch.rand(6, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64) * 0.1
        return sum(relative_error(lambda x, s=s: ball(x - s), CUBE, resolution, math.pi / 6) for s in shifts) / 6

    assert mean_error(12) / mean_error(48) > 4**3  # the order wanders about 4 with the place of the ball in its cells


def test_edges_cost_two_orders():
    def mean_error(resolution):
        shifts = torch.rand(6, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64) * 0.1
        boxes = (lambda x, s=s: Box((0.5, 0.3, 0.4)).jet((x - s) @ TURN).value for s in shifts)
        return sum(relative_error(box, CUBE, resolution, 0.48) for box in boxes) / 6

    assert mean_error(12) / mean_error(48) > 4**1.5


@pytest.mark.parametrize(
    ("field", "exact"),
    [
        (ball, math.pi / 6),
        (torus, 2 * math.pi**2 * 0.5 * 0.2**2),
        (lambda x: Box((0.5, 0.3, 0.4)).jet(x @ TURN).value, 0.48),
    ],
    ids=["ball", "torus", "box"],
)
def test_the_error_that_is_told_holds_the_true_one(field, exact):
    """Over places of the shape in its cells: the error is an estimate, seldom below half of the true one."""
    held = []
    for seed in range(6):
        shift = torch.rand(3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * 0.1
        for resolution in (24, 48):
            value, error = volume_with_error(lambda x, s=shift: field(x - s), CUBE, resolution)
            assert value == pytest.approx(exact, rel=5e-3)
            held.append(abs(value - exact) <= 2 * error)
    assert sum(held) >= len(held) - 2


@pytest.mark.parametrize("bounds", [CUBE, SQUARE], ids=["3D", "2D"])
def test_the_error_that_is_told_falls_as_the_true_one(bounds):
    shifts = torch.rand(8, bounds.shape[1], generator=torch.Generator().manual_seed(2), dtype=torch.float64) * 0.1
    fields = [lambda x, s=s: ball(x - s) for s in shifts]
    told = [sum(volume_with_error(field, bounds, n)[1] for field in fields) for n in (16, 64)]
    assert told[0] / told[1] > 4**2  # of second order at least, whatever the place in the cells
    assert volume_with_error(fields[0], bounds, 32)[0] == volume(fields[0], bounds, 32)


def test_one_band_gives_the_volume_at_all_levels_in_its_reach():
    lattice = Lattice.centers(CUBE, 48)
    band = sample_band(torus, lattice, reach=0.1)
    for level in (-0.1, -0.02, 0.05, 0.1):
        alone = volume(lambda x, c=level: torus(x) - c, CUBE, 48)
        assert volume_in_band(band, level) == pytest.approx(alone, rel=1e-9)


def test_a_half_space_is_exact_in_any_direction():
    generator = torch.Generator().manual_seed(0)
    normals = torch.randn(20, 3, generator=generator, dtype=torch.float64)
    normals = torch.cat([normals, torch.eye(3, dtype=torch.float64), -torch.eye(3, dtype=torch.float64)])
    for normal in normals:  # a plane through the middle halves the box
        assert volume(lambda x, n=normal: x @ n, CUBE, 9) == pytest.approx(4.0, abs=1e-6)


def test_what_leaves_the_box_is_cut_off():
    octant = torch.stack([torch.zeros(3), torch.ones(3)]).double()
    assert relative_error(ball, octant, 32, math.pi / 48) < 1e-3
    assert volume(lambda x: x[:, 0] * 0 - 1, CUBE, 8) == pytest.approx(8.0)
    assert volume(lambda x: x[:, 0] * 0 + 1, CUBE, 8) == 0.0


def test_oblong_boxes_have_nearly_cubic_cells():
    bounds = torch.tensor([[-1.0, -0.6, -0.7], [1.0, 0.8, 0.6]], dtype=torch.float64)
    assert relative_error(ball, bounds, 64, math.pi / 6) < 1e-4
    assert Lattice.centers(bounds, 64).shape == (64, 45, 42)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", MOTIONS)
def test_exact_motions_have_their_volume(name, dim):
    motion = MOTIONS[name](dim)
    for t in (0.0, 0.37, 1.0):
        assert relative_error(lambda x, t=t: motion(x, t), motion.bounds, 64, motion.volume(t)) < 3e-3


def test_cell_fractions_against_counting():
    generator = torch.Generator().manual_seed(0)
    rise = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    rise[:10, 1:] = 0
    mean = torch.randn(50, generator=generator, dtype=torch.float64) * 0.4
    axis = (torch.arange(60, dtype=torch.float64) + 0.5) / 60 - 0.5
    points = torch.cartesian_prod(axis, axis, axis)
    counted = (mean[:, None] + rise @ points.T < 0).double().mean(1)
    assert cell_fraction(mean, rise) == pytest.approx(counted, abs=0.02)
    assert cell_fraction(mean, rise) + cell_fraction(-mean, rise) == pytest.approx(torch.ones(50), abs=1e-7)


@pytest.mark.parametrize("seed", range(5))
def test_the_band_misses_nothing_of_a_wild_field(seed):
    """Sums of waves: every cell with a change of sign, and all its corners, are sampled."""
    generator = torch.Generator().manual_seed(seed)
    waves = 7 * torch.randn(3, 12, generator=generator, dtype=torch.float64)
    field = lambda x: (x @ waves).sin().sum(1) + 2.0  # noqa: E731
    lattice = Lattice.corners(CUBE, 61)
    band = sample_band(field, lattice).whole()
    index = torch.stack(torch.meshgrid(*(torch.arange(n) for n in lattice.shape), indexing="ij"), -1)
    dense = field(lattice.points(index.view(-1, 3))).view(lattice.shape)
    assert ((dense < 0) == (band.values < 0)).all()
    assert (band.values[band.known] == dense[band.known]).all()
    for axis in range(3):
        crossing = (dense < 0).diff(dim=axis)
        assert band.known.narrow(axis, 0, 61)[crossing].all()
        assert band.known.narrow(axis, 1, 61)[crossing].all()


def test_the_band_is_small():
    band = sample_band(ball, Lattice.corners(CUBE, 128)).whole()
    assert band.known.double().mean() < 0.12


def test_impossible_boxes_are_named():
    with pytest.raises(ValueError, match="`bounds` must be a box with positive edges"):
        volume(ball, CUBE.flip(0), 8)
    with pytest.raises(ValueError, match="resolution=0"):
        volume(ball, CUBE, 0)
