"""Colors say where points are, where they came from, and how large an error is."""

from __future__ import annotations

import pytest
import torch
from analytic import shrinking
from problems import growing_ball, rotating_box, squashed_ball, squashed_box, translating_ball

from nsm.cli.errors import InputError
from nsm.morphs.advected import advect_surface
from nsm.morphs.surfaces import extract_frame
from nsm.plots.colors import RESIDUALS, advected_colors, colormap, position_colors, residual_colors, surface_bounds

BOX = {dim: torch.tensor([[-1.0] * dim, [1.0] * dim]) for dim in (2, 3)}


def luminance(colors: torch.Tensor) -> torch.Tensor:
    """Relative luminance of sRGB (WCAG)."""
    linear = torch.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    return linear @ colors.new_tensor([0.2126, 0.7152, 0.0722])


def grid(dim: int, count: int = 9) -> torch.Tensor:
    """Points of the box, its corners too."""
    return torch.cartesian_prod(*[torch.linspace(-1, 1, count)] * dim)


def test_the_colormap_grows_lighter_and_clamps() -> None:
    colors = colormap(torch.linspace(0, 1, 50))
    assert colors.shape == (50, 3)
    assert 0 <= float(colors.min()) <= float(colors.max()) <= 1
    assert bool((luminance(colors).diff() > 0).all())
    assert torch.equal(colormap(torch.tensor([-1.0, 2.0])), colormap(torch.tensor([0.0, 1.0])))


@pytest.mark.parametrize("dim", [2, 3])
def test_colors_of_places_are_smooth_and_differ_where_places_do(dim: int) -> None:
    points = grid(dim)
    colors = position_colors(points, BOX[dim])
    assert colors.shape == (len(points), 3)
    assert 0 <= float(colors.min()) <= float(colors.max()) <= 1
    apart, contrast = torch.cdist(points, points), torch.cdist(colors, colors)
    others = apart > 0
    assert float((contrast[others] / apart[others]).max()) < 1.1
    assert float((contrast[others] / apart[others]).min()) > 0.05


def test_up_is_light() -> None:
    points = grid(3)
    light = luminance(position_colors(points, BOX[3])).view(9, 9, 9)
    assert bool((light.diff(dim=1) > 0).all())


def test_places_beyond_the_bounds_have_the_colors_of_the_rim_and_scale_does_not_matter() -> None:
    points = 3 * torch.randn(50, 3)
    assert torch.equal(position_colors(points, BOX[3]), position_colors(points.clamp(-1, 1), BOX[3]))
    torch.testing.assert_close(
        position_colors(7 * points + 1, 7 * BOX[3] + 1), position_colors(points, BOX[3]), rtol=0, atol=1e-5
    )


@pytest.mark.parametrize("motion", [rotating_box, squashed_box, translating_ball])
@pytest.mark.parametrize("dim", [2, 3])
def test_points_keep_the_colors_of_where_they_came_from(motion: type, dim: int) -> None:
    morph = motion(dim)
    carried = advect_surface(morph, [0.0, 0.4, 1.0], 16)
    expected = position_colors(carried.vertices[0], surface_bounds(morph, 0.0))
    for points, time in zip(carried.vertices, carried.times, strict=True):
        assert float((advected_colors(morph, points, time) - expected).abs().max()) < 1e-3


@pytest.mark.parametrize("what", RESIDUALS)
@pytest.mark.parametrize("motion", [growing_ball, rotating_box])
def test_an_exact_distance_that_is_advected_has_the_color_of_no_error(motion: type, what: str) -> None:
    morph = motion(3)
    points = torch.rand(50, 3, dtype=torch.float64) - 0.5
    points = points[morph(points, 0.5).abs() > 0.02]  # off the ridges that lie inside a box
    points = points[morph(points, 0.5) > 0]
    nothing = colormap(torch.zeros(len(points), dtype=torch.float64))
    assert float((residual_colors(morph, points, 0.5, what) - nothing).abs().max()) < 0.02


def test_a_residual_has_its_place_on_the_colormap() -> None:
    morph = squashed_ball(3)  # carried exactly, but no distance
    points = extract_frame(morph, 1.0, 12).mesh.vertices
    size = (morph.gradient(points, 1.0).norm(dim=1) - 1).abs()
    assert float(size.max()) > 0.1
    assert torch.equal(residual_colors(morph, points, 1.0, "eikonal", scale=0.3), colormap(size / 0.3))
    still = residual_colors(morph, points, 1.0, "level_set")
    assert float((still - colormap(torch.zeros_like(size))).abs().max()) < 0.02


def test_what_cannot_be_colored_is_said_in_one_sentence() -> None:
    points = torch.zeros(1, 3)
    morph = shrinking(3, 0.1)
    with pytest.raises(InputError, match="must have a velocity to advect"):
        advected_colors(morph, points, 0.5)
    with pytest.raises(InputError, match="needs a morph with a velocity"):
        residual_colors(morph, points, 0.5, "level_set")
    assert residual_colors(morph, points + 0.3, 0.5, "eikonal").shape == (1, 3)
    with pytest.raises(InputError, match="`what` must be one of level_set, eikonal, got speed"):
        residual_colors(squashed_ball(3), points.double(), 0.5, "speed")
    with pytest.raises(InputError, match="`scale` must be positive and finite, got 0"):
        residual_colors(squashed_ball(3), points.double(), 0.5, "eikonal", scale=0)
