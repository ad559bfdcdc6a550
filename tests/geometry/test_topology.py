"""Counts and angles on shapes where they are known."""

from __future__ import annotations

import math

import pytest
import torch
from problems import Ball

from nsm.geometry import topology
from nsm.geometry.meshing import extract_surface
from nsm.types import SimplexMesh

CUBE = torch.tensor([[-1.0] * 3, [1.0] * 3], dtype=torch.float64)
SQUARE = CUBE[:, :2]


def ball(x, *, centre=0.0, radius=0.3):
    return Ball(x.shape[1], radius).jet(x - centre).value


def torus(x):
    return torch.stack([x[:, :2].norm(dim=1) - 0.5, x[:, 2]], 1).norm(dim=1) - 0.2


def two_balls(x):
    return torch.minimum(ball(x, centre=-0.45), ball(x, centre=0.45, radius=0.2))


def shell(x):
    return ball(x, radius=0.5).abs() - 0.15


@pytest.mark.parametrize(
    ("field", "components", "euler", "genus"),
    [(ball, 1, 2, 0), (torus, 1, 0, 1), (two_balls, 2, 4, 0), (shell, 2, 4, 0)],
    ids=["ball", "torus", "two balls", "shell"],
)
def test_surfaces(field, components, euler, genus):
    mesh = extract_surface(field, CUBE, 40)
    assert topology.component_count(mesh) == components
    assert topology.euler_number(mesh) == euler
    assert topology.genus(mesh) == genus


@pytest.mark.parametrize(("field", "components"), [(ball, 1), (two_balls, 2), (shell, 2)])
def test_curves(field, components):
    mesh = extract_surface(field, SQUARE, 40)
    assert topology.component_count(mesh) == components
    assert topology.euler_number(mesh) == 0
    assert topology.genus(mesh) == 0


@pytest.mark.parametrize("field", [ball, torus, two_balls, shell])
def test_curvature_sums_to_the_euler_number(field):
    """Gauss and Bonnet: of the surface in 3D, of the inside in 2D, where the torus is two disks."""
    solid = extract_surface(field, CUBE, 40)
    curvature = topology.total_curvatures(solid)
    assert float(curvature.sum()) / (2 * math.pi) == pytest.approx(topology.euler_number(solid), abs=1e-6)
    plane = (lambda x: torus(torch.stack([x[:, 0], 0 * x[:, 0], x[:, 1]], 1))) if field is torus else field
    inside = {ball: 1, torus: 2, two_balls: 2, shell: 0}[field]
    turned = topology.total_curvatures(extract_surface(plane, SQUARE, 40))
    assert float(turned.sum()) / (2 * math.pi) == pytest.approx(inside, abs=1e-6)


def test_curvature_sits_at_the_corners_of_a_cube():
    corners = torch.tensor([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)], dtype=torch.double)
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = torch.tensor([t for a, b, c, d in faces for t in ([a, b, c], [a, c, d])])
    cube = SimplexMesh(corners, triangles)
    assert topology.euler_number(cube) == 2
    assert topology.total_curvatures(cube) == pytest.approx(torch.full((8,), math.pi / 2, dtype=torch.double))
    # without its lid only the four corners of the floor are inside
    open_cube = SimplexMesh(corners, triangles[2:])
    assert topology.total_curvatures(open_cube).count_nonzero() == 4


def test_triangles_with_two_corners_in_one_place_change_no_curvature():
    mesh = extract_surface(ball, CUBE, 12)
    start, end = mesh.simplices[0, :2].tolist()
    # an edge is cut by a vertex that lies on its first end
    twice = torch.cat([mesh.vertices, mesh.vertices[start : start + 1]])
    split = []
    for triangle in mesh.simplices.tolist():
        if start in triangle and end in triangle:
            new = len(mesh.vertices)
            split += [[new if v == end else v for v in triangle], [new if v == start else v for v in triangle]]
        else:
            split.append(triangle)
    cut = SimplexMesh(twice, torch.tensor(split))
    assert topology.euler_number(cut) == 2
    assert float(topology.total_curvatures(cut).sum()) == pytest.approx(4 * math.pi)


def test_measures_of_components_come_largest_first():
    areas = topology.component_measures(extract_surface(two_balls, CUBE, 96))
    assert areas == pytest.approx(torch.tensor([4 * math.pi * 0.09, 4 * math.pi * 0.04], dtype=torch.double), rel=5e-3)
    lengths = topology.component_measures(extract_surface(two_balls, SQUARE, 96))
    assert lengths == pytest.approx(torch.tensor([2 * math.pi * 0.3, 2 * math.pi * 0.2], dtype=torch.double), rel=5e-3)


def test_volume_has_a_sign():
    mesh = extract_surface(ball, CUBE, 64)
    assert topology.enclosed_volume(mesh) == pytest.approx(4 / 3 * math.pi * 0.027, rel=1e-2)
    turned = SimplexMesh(mesh.vertices, mesh.simplices.flip(1))
    assert topology.enclosed_volume(turned) == pytest.approx(-topology.enclosed_volume(mesh))


def test_angles_of_a_cube_and_a_square():
    """12 edges of 90° and 6 diagonals of 0° make 60°; a square turns by 90° at each corner."""
    corners = torch.cartesian_prod(*[torch.tensor([0.0, 1.0])] * 3)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = torch.tensor([tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))])
    cube = SimplexMesh(corners, faces)
    assert topology.enclosed_volume(cube) == pytest.approx(1)
    assert topology.mean_dihedral_angle(cube) == pytest.approx(60)
    square = SimplexMesh(
        torch.tensor([[0.0, 0], [1, 0], [1, 1], [0, 1]]), torch.tensor([[0, 1], [1, 2], [2, 3], [3, 0]])
    )
    assert topology.mean_dihedral_angle(square) == pytest.approx(90)
    assert topology.enclosed_volume(square) == pytest.approx(1)


@pytest.mark.parametrize("bounds", [CUBE, SQUARE], ids=["3D", "2D"])
def test_roughness_of_a_smooth_shape_is_proportional_to_the_cell(bounds):
    coarse, fine = (topology.mean_dihedral_angle(extract_surface(ball, bounds, n)) for n in (48, 96))
    assert coarse / fine == pytest.approx(2, rel=0.05)


def test_normals_of_vertices_are_those_of_the_sphere():
    mesh = extract_surface(ball, CUBE, 48)
    cosine = torch.cosine_similarity(topology.vertex_normals(mesh), mesh.vertices)
    assert cosine.mean() > 0.998


@pytest.mark.parametrize("dim", [2, 3])
def test_an_empty_mesh_has_nothing(dim):
    empty = SimplexMesh(torch.zeros(0, dim), torch.zeros(0, dim, dtype=torch.long))
    assert topology.component_count(empty) == topology.euler_number(empty) == topology.genus(empty) == 0
    assert topology.measure(empty) == topology.mean_dihedral_angle(empty) == topology.enclosed_volume(empty) == 0
    assert len(topology.component_measures(empty)) == len(topology.vertex_normals(empty)) == 0


def test_vertices_that_nothing_uses_do_not_count():
    mesh = extract_surface(ball, CUBE, 24)
    padded = SimplexMesh(torch.cat([torch.zeros(3, 3), mesh.vertices]), mesh.simplices + 3)
    assert topology.euler_number(padded) == 2
    assert topology.component_count(padded) == 1
