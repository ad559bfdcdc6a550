"""Shapes from pictures: exact squares, disks of images and drawings, holes, and pictures without a silhouette."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from nsm.cli.errors import InputError
from nsm.io.build import build
from nsm.shapes import Ball, Box, OutlineShape, Polygon, Silhouette, Similarity
from nsm.shapes.base import FieldShape

DRAWING = '<svg xmlns="http://www.w3.org/2000/svg" width="100" height="80">{}</svg>'


def _plane(count: int, generator: torch.Generator) -> torch.Tensor:
    return 2 * torch.rand(count, 2, generator=generator, dtype=torch.float64) - 1


def _square() -> np.ndarray:
    """60 columns and 40 rows of ones, in the upper left of an image of 100 columns and 80 rows."""
    image = np.zeros((80, 100))
    image[10:50, 20:80] = 1
    return image


def _disk(radius: float, center: tuple[float, float], parts: int) -> np.ndarray:
    """How much of each pixel a disk covers, from ``parts``² points of it; rows run downwards."""
    fine = (np.arange(200 * parts) + 0.5) / parts
    inside = np.hypot(fine[None] - center[0], 200 - fine[:, None] - center[1]) < radius
    return inside.reshape(200, parts, 200, parts).mean((1, 3))


def _save(path: Path, values: np.ndarray, kind: str = "dark") -> str:
    """Save an image: ``dark`` on white, ``bright`` on black, or ``opaque`` on nothing."""
    byte = np.round(255 * values).astype(np.uint8)
    if kind == "opaque":
        Image.fromarray(np.stack([byte * 0 + 90, byte * 0, byte * 0 + 200, byte], -1)).save(path)
    else:
        Image.fromarray(byte if kind == "bright" else 255 - byte).save(path)
    return str(path)


def _draw(path: Path, content: str) -> str:
    path.write_text(DRAWING.format(content))
    return str(path)


@pytest.mark.parametrize("kind", ["dark", "bright", "opaque"])
def test_the_silhouette_of_a_square_has_its_exact_distance(
    kind: str, tmp_path: Path, generator: torch.Generator
) -> None:
    shape, box = Silhouette(_save(tmp_path / "a.png", _square(), kind)), Box([1.6, 1.6 * 2 / 3], [0, 0])
    assert len(shape.vertices) == 4
    x = _plane(5000, generator)
    torch.testing.assert_close(shape(x), box(x), atol=1e-12, rtol=0)
    assert shape.volume() == pytest.approx(box.volume(), rel=1e-12)
    torch.testing.assert_close(shape.jet(x).gradient, box.jet(x).gradient, atol=1e-9, rtol=0)
    corners = Similarity.read(shape.provenance()["similarity"], 2).inverse().apply(shape.exact_bounds())
    torch.testing.assert_close(corners, torch.tensor([[20.0, 30], [80, 70]], dtype=torch.float64))


def test_a_drawn_square_has_its_exact_distance(tmp_path: Path, generator: torch.Generator) -> None:
    path = _draw(tmp_path / "a.svg", '<g transform="translate(20 10)"><rect width="60" height="40"/></g>')
    shape, x = Silhouette(path), _plane(5000, generator)
    torch.testing.assert_close(shape(x), Box([1.6, 1.6 * 2 / 3], [0, 0])(x), atol=1e-12, rtol=0)
    back = Similarity.read(shape.provenance()["similarity"], 2).inverse()
    corners = torch.tensor([[20.0, -50], [80, -10]], dtype=torch.float64)
    torch.testing.assert_close(back.apply(shape.exact_bounds()), corners)


@pytest.mark.parametrize(("parts", "off", "turned"), [(1, 0.45, 3.0), (8, 0.1, 1.0)])
def test_a_disk_has_the_area_of_its_pixels_and_smooth_normals(
    parts: int, off: float, turned: float, tmp_path: Path, generator: torch.Generator
) -> None:
    radius, center = 70.0, (98.3, 103.6)
    image = _disk(radius, center, parts)
    shape = Silhouette(_save(tmp_path / "a.png", image, "opaque"), fit=None)
    assert shape.volume() == pytest.approx(image.sum(), rel=1e-4)
    samples = shape.surface_samples(5000, generator)
    assert Ball(radius, center)(samples.points).abs().max() < off
    radial = torch.nn.functional.normalize(samples.points - torch.tensor(center), dim=1)
    angles = (radial * samples.normals).sum(1).clamp(max=1).acos()
    assert math.degrees(float(angles.mean())) < turned


def test_a_drawn_disk_is_a_disk(tmp_path: Path, generator: torch.Generator) -> None:
    shape = Silhouette(_draw(tmp_path / "a.svg", '<circle cx="50" cy="40" r="30" fill="#123"/>'))
    x = _plane(3000, generator)
    torch.testing.assert_close(shape(x), Ball(0.8, [0, 0])(x), atol=2e-4, rtol=0)


def test_holes_and_pieces_of_an_image(tmp_path: Path, generator: torch.Generator) -> None:
    image = np.zeros((60, 90))
    image[10:50, 10:50], image[20:40, 20:40], image[10:50, 60:80] = 1, 0, 1
    shape = Silhouette(_save(tmp_path / "a.png", image), fit=None)
    assert sorted(shape.loops) == [4, 4, 4]
    assert shape.volume() == pytest.approx(image.sum(), rel=1e-12)
    points = torch.tensor([[15.0, 30], [30, 30], [70, 30], [55, 30], [-9, 9]], dtype=torch.float64)
    torch.testing.assert_close(shape(points), torch.tensor([-5.0, 10, -10, 5, math.hypot(19, 1)], dtype=torch.float64))
    assert FieldShape.volume(shape) == pytest.approx(shape.volume(), rel=1e-3)


@pytest.mark.parametrize(
    ("content", "area"),
    [
        ('<path fill-rule="evenodd" d="M10 10H50V50H10Z M20 20H40V40H20Z"/>', 1200),
        ('<path d="M10 10H50V50H10Z M20 20H40V40H20Z"/>', 1600),  # both run the same way: no hole
        ('<path d="M10 10H50V50H10Z M20 20V40H40V20Z"/>', 1200),
        ('<rect width="100" height="80" fill="white"/><rect x="10" y="10" width="40" height="40"/>', 1600),
        ('<rect x="10" y="10" width="40" height="40"/><rect x="20" y="20" width="9" height="9" fill="#fff"/>', 1519),
        ('<rect x="10" y="10" width="40" height="40"/><rect x="30" y="30" width="40" height="40"/>', 2800),
        ('<rect x="10" y="10" width="40" height="40" fill="none" stroke="black"/>', 1600),
        ('<polygon points="10,10 50,10 10,50 50,50"/>', 800),  # crosses itself
        ('<rect width="9" height="9"/><rect width="50" height="50" visibility="hidden"/>', 81),
    ],
)
def test_drawings_are_filled_as_svg_says(content: str, area: float, tmp_path: Path) -> None:
    assert Silhouette(_draw(tmp_path / "a.svg", content), fit=None).volume() == pytest.approx(area, rel=1e-9)


def test_a_polygon_is_the_same_shape_as_an_outline(generator: torch.Generator) -> None:
    arrow = torch.tensor([[-0.6, -0.5], [0, -0.2], [0.6, -0.5], [0, 0.7]], dtype=torch.float64)
    pose = {"rotation": 25, "translation": [0.1, -0.05], "scale": 0.8}
    shape, polygon = OutlineShape(4, [4], pose, pose), Polygon(arrow.tolist(), pose)
    shape.vertices.copy_(arrow)
    x = _plane(4000, generator)
    torch.testing.assert_close(shape(x), polygon(x), atol=1e-12, rtol=0)
    torch.testing.assert_close(shape.jet(x).gradient, polygon.jet(x).gradient, atol=1e-9, rtol=0)
    assert shape.volume() == pytest.approx(polygon.volume())
    samples = shape.surface_samples(2000, generator)
    assert polygon(samples.points).abs().max() < 1e-6
    again = build(shape.config())
    again.load_state_dict(shape.state_dict())
    torch.testing.assert_close(again(x), shape(x))
    assert again.content_key() == shape.content_key()
    assert shape.transformed(Similarity.scaling(0.5, 2)).volume() == pytest.approx(shape.volume() / 4)


def test_what_is_no_silhouette_meets_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refused(path: str, words: str, **arguments: object) -> None:
        with pytest.raises(InputError, match=words) as error:
            Silhouette(path, **arguments)
        assert "\n" not in str(error.value)

    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "cut.png").write_bytes(Path(_save(tmp_path / "whole.png", _square())).read_bytes()[:60])
    (tmp_path / "a.svg").write_text("hello")
    refused(_save(tmp_path / "white.png", np.ones((30, 30))), "must show something in front of a background")
    refused(_save(tmp_path / "gray.png", 0.5 * _square()), "one side of the threshold 0.3", threshold=0.3)
    refused(str(tmp_path / "whole.png"), "`threshold` must be between 0 and 1, got 2", threshold=2.0)
    refused(str(tmp_path / "empty.png"), "got an empty file")
    refused(str(tmp_path / "cut.png"), "must contain an image in the format")
    refused(str(tmp_path / "a.svg"), "must contain an SVG drawing in the format")
    refused(_draw(tmp_path / "b.svg", ""), "must hold a filled or closed path, got 0 shapes")
    refused(_draw(tmp_path / "c.svg", '<line x2="9" y2="9" stroke="red"/>'), "must hold a filled or closed path")
    refused(_draw(tmp_path / "d.svg", "<rect width='9' height='9'/>"), "`threshold` must be null", threshold=0.5)
    refused(_save(tmp_path / "e.ppm", _square()), r"must end in .png, .* got '.ppm'")
    image = _square()
    image[:, 30:40] = 1
    Silhouette(_save(tmp_path / "f.png", image))
    assert "reaches the border of the image, where it is cut" in caplog.text
    monkeypatch.setitem(sys.modules, "svgelements", None)
    refused(str(tmp_path / "d.svg"), r"Reading .svg needs `svgelements`, .* Try `pip install 'nsm\[svg\]'`")
