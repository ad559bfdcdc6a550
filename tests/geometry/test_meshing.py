"""Extracted surfaces: where they lie, how they are turned, and that the fast way gives what the full grid gives."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from problems import MOTIONS, Ball, Box
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from nsm.geometry.band import sample_band
from nsm.geometry.grid import Lattice
from nsm.geometry.meshing import OFF_LEVEL, extract_surface, open_sides, surface_in_band
from nsm.geometry.topology import component_count, enclosed_volume, euler_number, measure, simplex_normals

CUBE = torch.tensor([[-1.0] * 3, [1.0] * 3], dtype=torch.float64)
SQUARE = CUBE[:, :2]


TURN = torch.matrix_exp(torch.tensor([[0, 0.3, 0.7], [-0.3, 0, -0.4], [-0.7, 0.4, 0]], dtype=torch.float64))


def ball(x, radius=0.5):
    return Ball(x.shape[1], radius).jet(x).value


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


def waves(seed, shift):
    generator = torch.Generator().manual_seed(seed)
    numbers = 6 * torch.randn(3, 10, generator=generator, dtype=torch.float64)
    return lambda x: (x @ numbers).sin().sum(1) + shift


def union(*balls):
    """Balls by middle and radius."""
    return lambda x: torch.stack([(x - x.new_tensor(c)).norm(dim=1) - r for c, r in balls], 1).amin(1)


TWO_BALLS = union(((-0.2, 0.0, 0.1), 0.5), ((0.83, 0.79, -0.81), 0.02))


def of_full_grid(field, bounds, resolution):
    """Vertices and triangles of marching cubes, f evaluated everywhere."""
    lattice = Lattice.corners(bounds, resolution)
    axes = [torch.arange(n, dtype=bounds.dtype) for n in lattice.shape]
    values = field(lattice.points(torch.cartesian_prod(*axes))).view(lattice.shape).double().numpy()
    values /= float(lattice.step.max())
    values[np.abs(values) < OFF_LEVEL] = -OFF_LEVEL
    vertices, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="descent")
    return vertices * lattice.step.numpy() + lattice.origin.numpy(), faces


def canonical(faces):
    """Triangles turned until their least vertex comes first, as a set."""
    turn = (faces.argmin(1)[:, None] + np.arange(3)) % 3
    return {tuple(face) for face in np.take_along_axis(faces, turn, 1).tolist()}


@pytest.mark.parametrize(
    ("field", "resolution"),
    [
        (waves(3, 1.5), 49),
        (waves(5, 0.0), 64),
        (ball, 31),
        (ball, 33),
        (ball, 65),
        (lambda x: 5 * ball(x), 64),
        (lambda x: 0.2 * ball(x), 64),
        (lambda x: ball(x).clamp(-0.1, 0.1), 96),
        (lambda x: torch.expm1(3 * ball(x)), 64),
        (TWO_BALLS, 96),
        (lambda x: 5 * TWO_BALLS(x), 96),
        (lambda x: 0.2 * TWO_BALLS(x), 96),
        (lambda x: Box((0.5, 0.3, 0.4)).jet(x @ TURN).value, 66),
    ],
    ids=[
        "waves",
        "waves at 0",
        "31",
        "33",
        "65",
        "steep",
        "flat",
        "clamped",
        "bent",
        "two",
        "two steep",
        "two flat",
        "box",
    ],
)
def test_the_mesh_is_that_of_the_full_grid(field, resolution):
    vertices, faces = of_full_grid(field, CUBE, resolution)
    mesh = extract_surface(field, CUBE, resolution)
    assert len(mesh.vertices) == len(vertices)
    distance, partner = cKDTree(vertices).query(mesh.vertices.numpy())
    assert distance.max() < 1e-6
    assert len(np.unique(partner)) == len(vertices)
    assert canonical(partner[mesh.simplices.numpy()]) == canonical(faces)


def test_the_mesh_of_an_oblong_box_is_that_of_the_full_grid():
    bounds = torch.tensor([[-0.7, -0.6, -1.0], [0.9, 0.55, 1.1]], dtype=torch.float64)
    vertices, faces = of_full_grid(TWO_BALLS, bounds, 70)
    mesh = extract_surface(TWO_BALLS, bounds, 70)
    assert len(mesh.simplices) == len(faces)
    assert cKDTree(vertices).query(mesh.vertices.numpy())[0].max() < 1e-6


def test_single_precision_gives_the_same_mesh():
    exact, single = extract_surface(TWO_BALLS, CUBE, 64), extract_surface(TWO_BALLS, CUBE.float(), 64)
    assert single.vertices.dtype == torch.float32
    assert (single.simplices == exact.simplices).all()
    assert single.vertices == pytest.approx(exact.vertices, abs=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_a_far_speck_is_found(seed):
    """Of a distance nothing is missed: a ball of a cell and a half across, wherever between the coarse samples."""
    x, y, z = (torch.rand(3, generator=torch.Generator().manual_seed(seed)) * 0.4 + 0.5).tolist()
    speck, cell = 1.5 / 2, 2 / 160
    mesh = extract_surface(union(((-0.5, -0.5, -0.5), 0.3), ((x, y, -z), speck * cell)), CUBE, 160)
    assert component_count(mesh) == 2


@pytest.mark.parametrize("dim", [2, 3])
def test_few_points_are_looked_at(dim):
    looked_at = []

    def field(x):
        looked_at.append(len(x))
        return ball(x)

    resolution = {2: 512, 3: 128}[dim]
    mesh = extract_surface(field, CUBE[:, :dim], resolution)
    assert sum(looked_at) < 12 * len(mesh.vertices) + 40**dim


def test_bricks_are_welded_along_their_faces():
    """Every edge of a surface through many bricks has two triangles."""
    mesh = extract_surface(lambda x: ball(x, 0.9), CUBE, 100)
    edges = torch.cat([mesh.simplices[:, [0, 1]], mesh.simplices[:, [1, 2]], mesh.simplices[:, [2, 0]]]).sort(1).values
    assert (edges.unique(dim=0, return_counts=True)[1] == 2).all()
    assert euler_number(mesh) == 2


def test_one_band_holds_all_levels_within_its_reach():
    lattice = Lattice.corners(CUBE, 48)
    band = sample_band(TWO_BALLS, lattice, reach=0.1)
    for level in (-0.1, -0.015, 0.06, 0.1):
        there, alone = surface_in_band(band, level), extract_surface(TWO_BALLS, CUBE, 48, level)
        assert (there.simplices == alone.simplices).all()
        assert there.vertices == pytest.approx(alone.vertices, abs=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_sides_where_a_surface_leaves_the_box_are_named(dim):
    bounds = CUBE[:, :dim]
    assert open_sides(extract_surface(ball, bounds, 24), bounds) == []
    corner = bounds.new_tensor([0.7] * dim)
    assert open_sides(extract_surface(lambda x: ball(x - corner), bounds, 24), bounds) == ["+x", "+y", "+z"][:dim]
    assert (
        open_sides(extract_surface(lambda x: x[:, 1], bounds, 9), bounds) == ["-x", "+x", "-z", "+z"][: 2 * (dim - 1)]
    )
    assert open_sides(extract_surface(lambda x: ball(x) + 5, bounds, 8), bounds) == []


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
