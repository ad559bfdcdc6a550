"""Extracted surfaces: where they lie, how they are turned, and that the fast way gives what the full grid gives."""

from __future__ import annotations

import math

import pytest
import torch
from problems import MOTIONS, Ball, Box
from skimage.measure import marching_cubes

from nsm.geometry.meshing import extract_surface
from nsm.geometry.topology import component_count, enclosed_volume, euler_number, measure, simplex_normals

CUBE = torch.tensor([[-1.0] * 3, [1.0] * 3], dtype=torch.float64)
SQUARE = CUBE[:, :2]


def ball(x):
    return Ball(x.shape[1], 0.5).jet(x).value


@pytest.mark.parametrize(("bounds", "area"), [(CUBE, math.pi), (SQUARE, math.pi)], ids=["sphere", "circle"])
def test_a_ball_becomes_a_sphere(bounds, area):
    mesh = extract_surface(ball, bounds, 48)
    assert measure(mesh) == pytest.approx(area, rel=3e-3)
    assert mesh.vertices.norm(dim=1) == pytest.approx(torch.full((len(mesh.vertices),), 0.5), abs=5e-4)
    middle = mesh.vertices[mesh.simplices].mean(1)
    assert ((simplex_normals(mesh) * middle).sum(1) > 0).all()
    assert mesh.vertices.dtype == bounds.dtype


@pytest.mark.parametrize("bounds", [CUBE, SQUARE], ids=["3D", "2D"])
def test_vertices_converge_with_second_order(bounds):
    def error(resolution):
        return (extract_surface(ball, bounds, resolution).vertices.norm(dim=1) - 0.5).abs().mean()

    assert 3 < error(24) / error(48) < 5.5


@pytest.mark.parametrize("bounds", [CUBE, SQUARE], ids=["3D", "2D"])
def test_a_level_other_than_zero_is_the_surface_at_that_distance(bounds):
    mesh = extract_surface(ball, bounds, 32, level=0.2)
    assert mesh.vertices.norm(dim=1) == pytest.approx(torch.full((len(mesh.vertices),), 0.7), abs=1e-3)


@pytest.mark.parametrize("bounds", [CUBE, SQUARE], ids=["3D", "2D"])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_no_surface_is_an_empty_mesh(bounds, sign):
    mesh = extract_surface(lambda x: torch.full_like(x[:, 0], sign), bounds, 16)
    assert mesh.vertices.shape == mesh.simplices.shape == (0, bounds.shape[1])


def test_the_mesh_is_that_of_the_full_grid():
    generator = torch.Generator().manual_seed(3)
    waves = 6 * torch.randn(3, 10, generator=generator, dtype=torch.float64)

    def field(x):
        return (x @ waves).sin().sum(1) + 1.5

    axis = torch.linspace(-1, 1, 50, dtype=torch.float64)
    dense = field(torch.cartesian_prod(axis, axis, axis)).view(50, 50, 50).numpy() / (2 / 49)
    vertices, faces, _, _ = marching_cubes(dense, 0.0)
    mesh = extract_surface(field, CUBE, 49)
    assert len(mesh.simplices) == len(faces)
    assert mesh.vertices.numpy() == pytest.approx(vertices * (2 / 49) - 1, abs=1e-6)


@pytest.mark.parametrize("half", [(0.5, 0.25, 0.75), (0.3, 0.3, 0.3)])
def test_faces_through_grid_points_stay_closed(half):
    """At 16 cells the first box has all its faces on corners of cells, where f is exactly 0."""
    mesh = extract_surface(lambda x: Box(half).jet(x).value, CUBE, 16)
    assert (euler_number(mesh), component_count(mesh)) == (2, 1)
    assert enclosed_volume(mesh) == pytest.approx(8 * math.prod(half), rel=0.06)
    flat = extract_surface(lambda x: Box(half[:2]).jet(x).value, SQUARE, 16)
    assert (euler_number(flat), component_count(flat)) == (0, 1)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", MOTIONS)
def test_exact_motions_enclose_their_volume(name, dim):
    motion = MOTIONS[name](dim)
    mesh = extract_surface(lambda x: motion(x, 0.6), motion.bounds, 48)
    assert enclosed_volume(mesh) == pytest.approx(motion.volume(0.6), rel=1e-2)
    assert (euler_number(mesh), component_count(mesh)) == (2 if dim == 3 else 0, 1)


def test_a_surface_that_leaves_the_box_is_open():
    corner = torch.stack([torch.zeros(3), torch.ones(3)]).double()
    mesh = extract_surface(ball, corner, 24)
    assert euler_number(mesh) == 1
    assert measure(mesh) == pytest.approx(math.pi / 8, rel=1e-2)
