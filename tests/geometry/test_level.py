"""Frames of exact volume: the mesh encloses what is asked for, at the level that the shape says."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest
import torch
from problems import MOTIONS, Ball, GrowingBall, LinearMotion

from nsm.cli.errors import InputError
from nsm.geometry.level import level_of_volume
from nsm.geometry.topology import enclosed_volume
from nsm.io.official import load_official
from nsm.morphs.growth import Grown, Table, VolumeLinear
from nsm.morphs.surfaces import ExactVolume, extract_frame, zero_level

CUBE = torch.tensor([[-1.0] * 3, [1.0] * 3], dtype=torch.float64)
both_dims = pytest.mark.parametrize("dim", [2, 3])


def ball(x, radius=0.4):
    return Ball(x.shape[1], radius).jet(x).value


@both_dims
@pytest.mark.parametrize("name", MOTIONS)
def test_every_frame_of_a_motion_encloses_the_volume_at_the_start(name, dim):
    motion = MOTIONS[name](dim)
    levels = ExactVolume(motion, 24)
    mesh = extract_frame(motion, 0.7, 24, levels(0.7)).mesh
    assert enclosed_volume(mesh) == pytest.approx(levels.wanted_volume(0.7), rel=2e-6)
    assert levels.wanted_volume(0.7) == levels.wanted_volume(0.0) == pytest.approx(motion.volume(0), rel=1e-3)


@both_dims
@pytest.mark.parametrize("slope", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("radius", [0.15, 0.37, 0.43, 0.8])
def test_levels_of_a_ball_are_differences_of_radii(radius, slope, dim):
    wanted = Ball(dim, radius).volume
    level = level_of_volume(lambda x: slope * ball(x), CUBE[:, :dim], 40, wanted)
    assert level / slope == pytest.approx(radius - 0.4, abs=5e-3)


@both_dims
def test_what_the_mesh_loses_to_its_cells_falls_with_second_order(dim):
    """The level of a surface that needs none only makes up for chords, O(h²)."""
    levels = [level_of_volume(ball, CUBE[:, :dim], n, Ball(dim).volume) for n in (16, 32, 64)]
    assert all(level > 0 for level in levels)
    assert 12 < levels[0] / levels[2] < 21


def test_a_field_that_is_no_distance_has_its_level_found():
    level = level_of_volume(lambda x: x.square().sum(1) - 0.16, CUBE, 32, Ball(3, 0.5).volume)
    assert level == pytest.approx(0.25 - 0.16, abs=3e-3)


@both_dims
def test_grown_frames_follow_the_wanted_curve(dim):
    grown = Grown(GrowingBall(dim, 0.4, -0.02), Table(dim, [0, 0.5, 1], [1.0, 2.0, 1.5]))
    levels = ExactVolume(grown, 32)
    for t, factor in ((0.0, 1.0), (0.5, 2.0), (1.0, 1.5)):
        mesh = extract_frame(grown, t, 32, levels(t)).mesh
        assert levels.wanted_volume(t) == pytest.approx(factor * Ball(dim).volume, rel=1e-5)
        assert enclosed_volume(mesh) == pytest.approx(levels.wanted_volume(t), rel=2e-6)
        assert levels(t) == pytest.approx(0.02 * t * factor ** (1 / dim), abs=5e-3)  # what f itself loses


def test_a_level_is_found_once():
    class Counted(LinearMotion):
        calls = 0

        def __call__(self, x, t):
            self.calls += 1
            return super().__call__(x, t)

    motion = Counted(Ball(2), drift=[0.6, 0.3])
    levels = ExactVolume(motion, 16)
    first, calls = levels(0.5), motion.calls
    assert (levels(0.5), motion.calls) == (first, calls)
    assert zero_level(0.5) == 0


def test_a_surface_that_leaves_the_box_has_no_exact_volume():
    away = LinearMotion(Ball(3), drift=[0.9, 0.0, -0.9])
    levels = ExactVolume(away, 16)
    levels(0.0)
    with pytest.raises(InputError, match=r"At t = 1: `bounds` must contain the surface .* at \+x, -z\."):
        levels(1.0)


@pytest.mark.parametrize("field", [lambda x: ball(x) + 3, lambda x: ball(x).clamp(-0.001, 0.1)])
def test_a_volume_that_no_level_encloses_is_named(field):
    with pytest.raises(InputError, match="`resolution` must be high enough for a level that encloses the volume 2"):
        level_of_volume(field, CUBE, 12, 2.0)


@both_dims
def test_a_frame_tells_once_where_the_surface_leaves_the_box(dim, caplog: pytest.LogCaptureFixture):
    away = LinearMotion(Ball(dim), drift=[0.9, 0.7, -0.9][:dim])
    with caplog.at_level(logging.WARNING):
        extract_frame(away, 0.3, 16)
        assert not caplog.records
        extract_frame(away, 1.0, 16)
    (record,) = caplog.records
    assert f"At t = 1 the surface leaves the box through its sides {'+x, +y, -z' if dim == 3 else '+x, +y'} and" in (
        record.getMessage()
    )


def test_a_shape_may_fill_the_box_that_it_grows_into(caplog: pytest.LogCaptureFixture):
    """Of a grown morph it is the scaled box that counts: beyond that nothing is known, though there is room."""
    grown = Grown(LinearMotion(Ball(2, 0.5), drift=[0.9, 0.0]), VolumeLinear(2, 4.0, 1.0))
    with caplog.at_level(logging.WARNING):
        extract_frame(grown, 0.0, 24)
        assert not caplog.records
        extract_frame(grown, 1.0, 24)
    assert "leaves the box through its sides +x and" in caplog.records[0].getMessage()


@torch.no_grad()
def test_an_official_morph_needs_levels_that_nobody_sees(data_dir: Path):
    morph = load_official("cylinders_torus")
    levels = ExactVolume(morph, 32)
    mesh = extract_frame(morph, 0.5, 32, levels(0.5)).mesh
    assert enclosed_volume(mesh) == pytest.approx(levels.wanted_volume(0.5), rel=1e-5)
    assert 0 < abs(levels(0.5)) < 0.01
