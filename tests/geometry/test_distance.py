"""Distances between meshes and points drawn from them."""

from __future__ import annotations

import math

import pytest
import torch
from problems import Ball

from nsm.geometry.distance import DistanceSummary, closest_points
from nsm.geometry.meshing import extract_surface
from nsm.geometry.sampling import sample_mesh
from nsm.types import SimplexMesh

CUBE = torch.tensor([[-1.0] * 3, [1.0] * 3], dtype=torch.float64)


def sphere(dim, radius, resolution=64):
    return extract_surface(lambda x: Ball(dim, radius).jet(x).value, CUBE[:, :dim], resolution)


@pytest.mark.parametrize("dim", [2, 3])
def test_spheres_inside_each_other(dim, generator):
    inner, outer = sphere(dim, 0.4), sphere(dim, 0.6)
    for a, b in ((inner, outer), (outer, inner)):
        points = sample_mesh(a, 2000, generator).points
        found = closest_points(points, b)
        assert found.distances == pytest.approx(torch.full((2000,), 0.2), abs=1e-3)
        assert (points - found.points).norm(dim=1) == pytest.approx(found.distances, abs=1e-9)
        # the closest point lies in the direction of the point
        assert torch.cosine_similarity(points, found.points) == pytest.approx(torch.ones(2000), abs=1e-3)


@pytest.mark.parametrize("dim", [2, 3])
def test_points_of_a_mesh_are_on_it(dim, generator):
    mesh = sphere(dim, 0.5, 16)
    samples = sample_mesh(mesh, 500, generator)
    found = closest_points(samples.points, mesh)
    assert found.distances.max() < 1e-7
    corners = mesh.vertices[mesh.simplices[samples.simplices]]
    assert ((samples.points >= corners.amin(1) - 1e-9) & (samples.points <= corners.amax(1) + 1e-9)).all()


def test_one_triangle_and_one_segment_by_hand():
    triangle = SimplexMesh(torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), torch.tensor([[0, 1, 2]]))
    points = torch.tensor([[0.2, 0.2, 0.5], [-3.0, -4.0, 0.0], [1.0, 1.0, 0.0]])
    assert closest_points(points, triangle).distances == pytest.approx(torch.tensor([0.5, 5.0, math.sqrt(0.5)]))
    segment = SimplexMesh(torch.tensor([[0.0, 0], [1, 0]]), torch.tensor([[0, 1]]))
    found = closest_points(torch.tensor([[0.5, 0.3], [4.0, 4.0], [-1.0, 0.0]]), segment)
    assert found.distances == pytest.approx(torch.tensor([0.3, 5.0, 1.0]))
    assert found.simplices.tolist() == [0, 0, 0]


@pytest.mark.parametrize("dim", [2, 3])
def test_points_are_spread_evenly(dim, generator):
    """Small simplices get as many points as their measure is worth: octants of a sphere get equal shares."""
    points = sample_mesh(sphere(dim, 0.5, 33), 40_000, generator).points
    octant = ((points > 0) * torch.tensor([1, 2, 4])[:dim]).sum(1)
    share = octant.bincount(minlength=2**dim) / len(points) * 2**dim
    assert share == pytest.approx(torch.ones(2**dim), abs=0.05)
    assert points.mean(0) == pytest.approx(torch.zeros(dim), abs=0.01)


def test_the_same_seed_draws_the_same_points():
    mesh = sphere(3, 0.5, 12)
    first, second = (sample_mesh(mesh, 50, torch.Generator().manual_seed(7)) for _ in range(2))
    assert torch.equal(first.points, second.points)


def test_summary():
    summary = DistanceSummary.of(torch.arange(101.0))
    assert summary == (50.0, 99.0, 100.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_an_empty_mesh_is_named(dim):
    empty = SimplexMesh(torch.zeros(0, dim), torch.zeros(0, dim, dtype=torch.long))
    with pytest.raises(ValueError, match="`mesh` must have at least one simplex"):
        closest_points(torch.zeros(1, dim), empty)
    with pytest.raises(ValueError, match="`mesh` must have a positive area"):
        sample_mesh(empty, 3, torch.Generator())
