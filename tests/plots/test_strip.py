"""Strips show the shape where it is and as large as it is, in the right colors."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from pictures import Sliding, colored, middle, picture
from problems import MOTIONS, Ball, LinearMotion

from nsm.cli.errors import InputError
from nsm.geometry.meshing import extract_surface
from nsm.plots import colors
from nsm.plots.colors import advected_colors
from nsm.plots.look import Look, camera_for
from nsm.plots.strip import render_strip

COARSE = Look(resolution=32)


def red(morph, points, time):
    return torch.tensor([0.8, 0.2, 0.2]).expand(len(points), 3)


def test_a_ball_is_where_it_should_be_and_as_large(tmp_path: Path) -> None:
    motion = Sliding()
    size, times = 120, [0.0, 1.0]
    render_strip(tmp_path / "strip.png", motion, times, size=size, look=COARSE)
    pixels = picture(tmp_path / "strip.png")
    camera = camera_for(motion, COARSE, times)
    height = round(size * camera.aspect)
    assert pixels.shape[1] == 2 * size
    assert pixels.shape[0] > height
    for number, time in enumerate(times):
        tile = colored(pixels)[:height, number * size : (number + 1) * size]
        share = math.pi * motion.shape.radius**2 / (4 * camera.half_width * camera.half_height)
        assert tile.mean() == pytest.approx(share, rel=0.03)
        right, up = camera.on_picture((motion.start + time * motion.drift).numpy()[None])[0]
        assert middle(tile) == pytest.approx([height * (1 - up) / 2 - 0.5, size * (1 + right) / 2 - 0.5], abs=1.0)
        # no holes: every row of the disk is one run of pixels
        assert all((np.diff(row.astype(int)) != 0).sum() <= 2 for row in tile)


def test_pictures_are_bright_on_paper_that_is_white_at_the_rim(tmp_path: Path) -> None:
    render_strip(tmp_path / "strip.png", MOTIONS["rotating_box"](3), [0.5], size=160, look=COARSE)
    pixels = picture(tmp_path / "strip.png")[:150]
    rows, _ = np.nonzero(colored(pixels))
    shape = pixels[colored(pixels)]
    assert shape.mean() > 130
    assert shape.max() < 255
    assert all((edge == 255).all() for edge in (pixels[0], pixels[:, 0], pixels[:, -1]))
    paper = ~colored(pixels)
    gray = pixels[paper]
    assert np.ptp(gray, axis=1).max() <= 12
    # the shadow lies below the shape, not above it
    shaded = paper & (pixels.mean(-1) < 240)
    assert shaded[rows.max() - 5 :].sum() > 20
    assert not shaded[: rows.min()].any()


def test_long_names_stand_whole_beside_their_rows(tmp_path: Path) -> None:
    motion, names = Sliding(), ["without the Dirichlet term of ambient points", "a"]
    render_strip(tmp_path / "strip.png", dict.fromkeys(names, motion), [0.0], size=80, look=COARSE)
    pixels = picture(tmp_path / "strip.png")
    margin = pixels[:, :-80].min(-1) < 200
    written = np.flatnonzero(margin.any(0))
    assert written[0] > 0
    assert written[-1] < margin.shape[1] - 1
    height = round(80 * camera_for(motion, COARSE, [0.0]).aspect)
    for row in (margin[:height], margin[height : 2 * height]):
        lines = np.flatnonzero(row.any(1))
        assert np.ptp(lines) < 20
        assert lines.mean() == pytest.approx(height / 2, abs=5)


def test_levels_and_colors_of_a_look_are_drawn(tmp_path: Path) -> None:
    motion = LinearMotion(Ball(3, 0.4))
    thick = COARSE._replace(levels=lambda morph: lambda time: 0.1 * time, colors=red)
    render_strip(tmp_path / "strip.png", motion, [0.0, 1.0], size=100, look=thick)
    pixels = picture(tmp_path / "strip.png")
    thin, grown = (colored(pixels[:100, part]) for part in (slice(0, 100), slice(100, 200)))
    assert grown.sum() / thin.sum() == pytest.approx((0.5 / 0.4) ** 2, rel=0.05)
    shape = pixels[colored(pixels)]
    assert shape[:, 0].mean() > 1.8 * shape[:, 2].mean()


def test_colors_of_samples_are_interpolated_to_all_points(monkeypatch: pytest.MonkeyPatch) -> None:
    motion = MOTIONS["squashed_ball"](3)
    points = extract_surface(partial(motion, t=0.7), motion.bounds, 100).vertices
    assert len(points) > 7000
    interpolated = advected_colors(motion, points, 0.7)
    monkeypatch.setattr(colors, "_SAMPLES", len(points))
    assert (interpolated - advected_colors(motion, points, 0.7)).abs().max() < 0.02


def test_filled_pixels_are_the_area_of_a_flat_shape(tmp_path: Path) -> None:
    motion, size = MOTIONS["rotating_box"](2), 200
    look = Look(resolution=200, colors=red)
    render_strip(tmp_path / "strip.png", {"turning": motion}, [0.4], size=size, look=look)
    pixels = picture(tmp_path / "strip.png")
    # the outline lies half outside: 1.6 points at 400 pixels, of which 72 are 200 pixels
    rim = 4 * (0.55 + 0.3) * (size / 2) * (1.6 * size / 400 * 200 / 72) / 2
    area = (colored(pixels).sum() - rim) * (2 / size) ** 2
    assert area == pytest.approx(motion.volume(0.4), rel=0.03)


def test_several_flat_morphs_are_rows_at_all_times(tmp_path: Path) -> None:
    morphs = {name: MOTIONS[name](2) for name in ("rotating_box", "squashed_ball")}
    done = []
    tell = lambda number, total: done.append((number, total))  # noqa: E731
    render_strip(tmp_path / "strip.png", morphs, [0.0, 0.5, 1.0], size=60, look=COARSE, progress=tell)
    height, width, _ = picture(tmp_path / "strip.png").shape
    assert 4 * 60 <= width <= 5 * 60  # names stand to the left
    assert 2 * 60 <= height <= 3 * 60
    assert done == [(number, 6) for number in range(1, 7)]


def test_a_shape_that_vanishes_leaves_white_paper(tmp_path: Path) -> None:
    class Gone(LinearMotion):
        def __call__(self, x, t):
            return super().__call__(x, t) + t

    render_strip(tmp_path / "2.png", Gone(Ball(2)), [0.0, 1.0], size=60, look=COARSE)
    render_strip(tmp_path / "3.png", Gone(Ball(3)), [0.0, 1.0], size=60, look=COARSE)
    pixels = picture(tmp_path / "3.png")[:40]
    assert colored(pixels[:, :60]).any()
    assert (pixels[:, 60:] == 255).all()


def test_strips_that_cannot_be_are_refused(tmp_path: Path) -> None:
    ball = LinearMotion(Ball(3))
    with pytest.raises(InputError, match=r"dimensions \[2, 3\]"):
        render_strip(tmp_path / "strip.png", {"a": LinearMotion(Ball(2)), "b": ball})
    with pytest.raises(InputError, match=r"must end in .*, got .*strip\.xyz"):
        render_strip(tmp_path / "strip.xyz", ball)
    with pytest.raises(InputError, match="directions in space that are not parallel"):
        render_strip(tmp_path / "strip.png", ball, [0.0], look=Look(16, view=(0, 1, 0)))
    assert not list(tmp_path.iterdir())
