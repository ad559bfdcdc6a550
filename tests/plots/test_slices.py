"""Pictures of residuals and of curves over time: what they hold, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from PIL import Image
from problems import MOTIONS, Ball, LinearMotion

from nsm.cli.errors import InputError
from nsm.metrics.residuals import eikonal_residual, level_set_residual
from nsm.plots.curves import plot_curves
from nsm.plots.slices import SlicePlane, _slice, plot_residual_slices


class Silent(LinearMotion):
    has_velocity = False

    def velocity(self, x, t):
        return None


def shape_of(path):
    with Image.open(path) as picture:
        return picture.size


@pytest.mark.parametrize(("axis", "across"), [("x", (1, 2)), ("y", (0, 2)), ("z", (0, 1))])
def test_a_slice_is_the_plane_that_was_asked_for(axis, across):
    """f of a ball off the middle, pixel by pixel; rows go up, columns to the right."""
    motion = MOTIONS["translating_ball"](3)
    piece = _slice(motion, 0.5, SlicePlane(axis, 0.2), eikonal_residual, 20)
    assert piece.extent == (-1, 1, -1, 1)
    ticks = torch.arange(20, dtype=torch.double) / 10 - 0.95
    up, right = torch.meshgrid(ticks, ticks, indexing="ij")
    points = torch.full((20, 20, 3), 0.2, dtype=torch.double)
    points[..., across[0]], points[..., across[1]] = right, up
    assert piece.values == pytest.approx(motion(points.view(-1, 3), 0.5).view(20, 20).numpy())
    assert np.abs(piece.residual).max() < 1e-9


def test_the_residual_of_a_wrong_velocity_is_shown():
    class Late(LinearMotion):
        def velocity(self, x, t):
            return super().velocity(x, t) / 2

    late = Late(Ball(2), drift=[0.6, 0.0])
    # half of the drift is missing: 0.3 |cos φ|
    piece = _slice(late, 0.0, SlicePlane(), level_set_residual, 40)
    ticks = torch.arange(40, dtype=torch.double) / 20 - 0.975
    up, right = torch.meshgrid(ticks, ticks, indexing="ij")
    assert piece.residual == pytest.approx((0.3 * right / torch.hypot(up, right)).abs().numpy(), abs=1e-3)


@pytest.mark.parametrize("dim", [2, 3])
def test_rows_are_morphs_and_residuals(tmp_path, dim):
    moving, still = MOTIONS["translating_ball"](dim), Silent(Ball(dim))
    plot_residual_slices(tmp_path / "one.png", moving, [0.5], resolution=16)
    plot_residual_slices(tmp_path / "two.png", {"a": moving, "b": moving}, [0.0, 1.0], resolution=16)
    plot_residual_slices(tmp_path / "still.png", {"a": moving, "still": still}, [0.0, 1.0], resolution=16)
    heights = [shape_of(tmp_path / f"{name}.png")[1] for name in ("one", "still", "two")]
    # two rows, three (the one without velocity has no level set residual), and four
    assert np.diff(heights) == pytest.approx(heights[0] / 2, rel=0.15)
    assert shape_of(tmp_path / "two.png")[0] > 1.5 * shape_of(tmp_path / "one.png")[0]


def test_a_morph_that_is_gone_is_drawn_without_a_contour(tmp_path):
    class Gone(LinearMotion):
        def __call__(self, x, t):
            return super().__call__(x, t).abs() + 1

    plot_residual_slices(tmp_path / "gone.png", Gone(Ball(2)), [0.5], resolution=16)
    assert (tmp_path / "gone.png").is_file()


@pytest.mark.parametrize(
    ("times", "plane", "words"),
    [
        ([], SlicePlane(), r"a list of times from 0 to 1, got \[\]"),
        ([1.5], SlicePlane(), r"a list of times from 0 to 1, got \[1.5\]"),
        ([0.5], SlicePlane("w"), "`axis` must be one of x, y, z, got w"),
        ([0.5], SlicePlane("xy"), "`axis` must be one of x, y, z, got xy"),
        ([0.5], SlicePlane("x", 1.2), "between -1 and 1, got 1.2. Try `offset=0`"),
    ],
)
def test_what_cannot_be_sliced(tmp_path, times, plane, words):
    with pytest.raises(InputError, match=words):
        plot_residual_slices(tmp_path / "no.png", MOTIONS["translating_ball"](3), times, plane)
    assert not list(tmp_path.iterdir())


def test_planes_and_spaces_share_no_picture(tmp_path):
    morphs = {"flat": MOTIONS["translating_ball"](2), "solid": MOTIONS["translating_ball"](3)}
    with pytest.raises(InputError, match=r"got dimensions \[2, 3\]"):
        plot_residual_slices(tmp_path / "no.png", morphs)


def test_panels_fill_rows(tmp_path):
    line = {"a": ([0.0, 1.0], [1.0, 2.0]), "gone": ([0.0, 1.0], [float("nan")] * 2)}
    for count in (1, 3, 4):
        plot_curves(tmp_path / f"{count}.png", {f"panel {n}": line for n in range(count)})
    one, three, four = (shape_of(tmp_path / f"{count}.png") for count in (1, 3, 4))
    assert three[0] == pytest.approx(3 * one[0], abs=2)
    assert three[1] == one[1]
    assert four[0] == three[0]
    assert four[1] > 1.7 * three[1]
