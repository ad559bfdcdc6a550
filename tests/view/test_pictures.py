"""Pictures of the viewer: triangles, figures, and colors."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
import torch
from analytic import shrinking
from problems import Ball, GrowingBall, growing_ball, squashed_ball, translating_ball

from nsm.cli.errors import InputError
from nsm.geometry.meshing import extract_surface
from nsm.geometry.topology import enclosed_volume
from nsm.io.gltf import encode_glb
from nsm.io.palette import srgb_from_linear
from nsm.morphs.growth import Grown, VolumeLinear
from nsm.plots.colors import advected_colors
from nsm.types import SimplexMesh
from nsm.view.flat import filled, ribbon
from nsm.view.pictures import PictureMaker, Settings

COARSE = Settings(resolution=16)


def triangle_areas(mesh: SimplexMesh) -> np.ndarray:
    """Areas of triangles in the plane z = const, positive where they are counter-clockwise."""
    a, b, c = mesh.vertices[mesh.simplices].numpy().swapaxes(0, 1)
    return np.cross(b - a, c - a)[:, 2] / 2


def read_glb(content: bytes) -> tuple[dict, bytes]:
    magic, version, total = struct.unpack_from("<III", content)
    assert (magic, version, total) == (0x46546C67, 2, len(content))
    length, kind = struct.unpack_from("<II", content, 12)
    assert kind == 0x4E4F534A
    return json.loads(content[20 : 20 + length]), content[20 + length + 8 :]


def glb_array(content: bytes, name: str) -> np.ndarray:
    """An attribute of the only mesh, or its indices."""
    document, body = read_glb(content)
    primitive = document["meshes"][0]["primitives"][0]
    accessor = document["accessors"][primitive["indices"] if name == "indices" else primitive["attributes"][name]]
    start, width = (
        document["bufferViews"][accessor["bufferView"]]["byteOffset"],
        {"VEC3": 3, "VEC4": 4, "SCALAR": 1}[accessor["type"]],
    )
    kind = {5126: np.float32, 5123: np.uint16, 5125: np.uint32}[accessor["componentType"]]
    return np.frombuffer(body, kind, accessor["count"] * width, start).reshape(-1, width)


def glb_colors(content: bytes) -> torch.Tensor:
    """Colors of the vertices, sRGB in 0..1."""
    return srgb_from_linear(torch.tensor(glb_array(content, "COLOR_0")[:, :3] / 65535))


@pytest.mark.parametrize("count", [5, 70_000])
def test_a_still_glb_reads_back_as_it_was_written(count: int) -> None:
    torch.manual_seed(0)
    vertices, colors = torch.randn(count, 3), torch.rand(count, 3)
    normals, faces = torch.nn.functional.normalize(torch.randn(count, 3)), torch.randint(count, (7, 3))
    content = encode_glb(SimplexMesh(vertices, faces), normals, colors)
    assert glb_array(content, "POSITION") == pytest.approx(vertices.numpy(), rel=1e-6)
    assert glb_array(content, "NORMAL") == pytest.approx(normals.numpy(), abs=1e-6)
    assert (glb_array(content, "indices").reshape(-1, 3) == faces.numpy()).all()
    assert glb_colors(content).numpy() == pytest.approx(colors.numpy(), abs=1e-3)


@pytest.mark.parametrize("field", [
    lambda x: x.norm(dim=1) - 0.6,
    lambda x: (x.norm(dim=1) - 0.6).abs() - 0.15,  # a ring
    lambda x: torch.minimum((x - 0.5).norm(dim=1), (x + 0.5).norm(dim=1)) - 0.3,  # two disks
])  # fmt: skip
def test_the_triangles_of_a_flat_shape_cover_its_inside(field) -> None:
    bounds = torch.tensor([[-1.0, -1.0], [1.0, 1.0]])
    mesh = extract_surface(field, bounds, 64)
    areas = triangle_areas(filled(mesh, field, 0.0))
    assert (areas >= 0).all()
    assert areas.sum() == pytest.approx(enclosed_volume(mesh), rel=2e-3)


def test_an_outline_without_inside_has_no_triangles() -> None:
    line = SimplexMesh(torch.tensor([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]]), torch.tensor([[0, 1], [1, 2]]))
    for mesh in (line, SimplexMesh(line.vertices[:2], line.simplices[:1])):
        assert filled(mesh, lambda x: x[:, 0], 0.0).simplices.shape == (0, 3)


def test_a_ribbon_runs_along_its_segments_and_faces_the_viewer() -> None:
    mesh = extract_surface(lambda x: x.norm(dim=1) - 0.6, torch.tensor([[-1.0, -1.0], [1.0, 1.0]]), 32)
    band = ribbon(mesh, 2.0)
    vertices = band.vertices.numpy()
    ends = mesh.vertices[mesh.simplices].numpy()
    corners = vertices.reshape(-1, 4, 3)
    assert np.abs(corners[:, :2, :2].mean(1) - ends[:, 0]).max() < 0.01
    assert np.abs(corners[:, 2:, :2].mean(1) - ends[:, 1]).max() < 0.01
    assert (triangle_areas(band) > 0).all()
    assert (vertices[:, 2] > 0).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_figures_of_a_growing_ball(dim: int) -> None:
    morph = growing_ball(dim)
    surface = PictureMaker(morph).surface(0.5, Settings(32))
    assert surface.volume == pytest.approx(morph.volume(0.5), rel=1e-3)
    assert surface.deviation == pytest.approx(morph.volume(0.5) / morph.volume(0.0) - 1, rel=1e-3)
    assert surface.components == 1


def test_the_level_offset_moves_the_surface_by_that_much() -> None:
    surface = PictureMaker(translating_ball(3)).surface(0.5, Settings(24, offset=0.1))
    assert surface.level == 0.1
    assert surface.volume == pytest.approx(Ball(3, 0.5).volume, rel=1e-3)


def test_frames_of_exact_volume_have_it_at_all_times() -> None:
    maker = PictureMaker(GrowingBall(3, growth=0.1))
    for instant in (0.0, 0.6):
        surface = maker.surface(instant, Settings(24, exact=True))
        assert abs(surface.deviation) < 1e-4
        assert enclosed_volume(surface.mesh) == pytest.approx(surface.volume)
    assert surface.level == pytest.approx(-0.1 * 0.6, abs=5e-3)  # that of the ball as it was at the start


def test_a_changing_volume_is_what_is_wanted() -> None:
    maker = PictureMaker(Grown(squashed_ball(3), VolumeLinear(3, 1.0, 1.5)))
    assert maker.wanted_volume(1.0) == pytest.approx(1.5 * Ball(3).volume, rel=1e-3)
    assert maker.surface(1.0, Settings(32)).deviation == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("color", ["clay", "position", "level_set", "eikonal", "advected"])
def test_every_color_is_given_to_every_vertex(dim: int, color: str) -> None:
    maker, settings = PictureMaker(translating_ball(dim, torch.float32)), Settings(12, color=color)
    content = maker.picture(maker.surface(0.5, settings), 0.5, settings).glb
    assert content is not None
    document, _ = read_glb(content)
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    counts = {document["accessors"][attributes[name]]["count"] for name in ("POSITION", "COLOR_0")}
    assert len(counts) == 1


def test_a_time_without_a_surface_has_no_triangles() -> None:
    maker = PictureMaker(shrinking(3, 2.0))
    surface = maker.surface(1.0, COARSE)
    assert maker.picture(surface, 1.0, COARSE).glb is None
    assert (surface.volume, surface.components) == (0.0, 0)


def test_colors_that_cannot_be_are_refused() -> None:
    with pytest.raises(InputError, match="`color` must be one of clay"):
        Settings(color="red").check([shrinking(3, 0.1)])
    with pytest.raises(InputError, match="must be given a morph with a velocity"):
        Settings(color="advected").check([shrinking(3, 0.1)])
    Settings(color="advected").check([shrinking(3, 0.1), translating_ball(3)])  # the first is then shown in clay


def test_advected_colors_reach_every_vertex_of_a_picture() -> None:
    maker, settings = PictureMaker(translating_ball(3, torch.float32)), Settings(96, color="advected")
    surface = maker.surface(0.5, settings)
    shown = glb_colors(maker.picture(surface, 0.5, settings).glb or b"")
    assert len(shown) > 4000
    assert (shown - advected_colors(maker.morph, surface.mesh.vertices, 0.5)).abs().max() < 1e-3
