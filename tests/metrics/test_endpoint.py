"""Deviation from the end shapes against deviations that are known."""

from __future__ import annotations

import math
from functools import partial

import pytest
import torch
import trimesh
from measured import Still
from problems import MOTIONS, Ball, LinearMotion

from nsm.metrics.endpoint import angles, endpoint_errors
from nsm.shapes import MeshFile


@pytest.mark.parametrize("dim", [2, 3])
def test_a_ball_of_the_wrong_size_is_that_far_away(dim):
    """The end is 0.05 too small: so are all distances, and f scaled by 1/4 changes none of them."""
    motion = MOTIONS["translating_ball"](dim)
    motion_at_end = partial(Ball(dim, 0.45).jet)
    centre = motion.start + motion.drift

    class Faint(LinearMotion):
        def __call__(self, x, t):
            return super().__call__(x, t) / 4

    for morph in (motion, Faint(Ball(dim), drift=motion.drift.tolist(), start=motion.start.tolist())):
        errors = endpoint_errors(morph, 1.0, lambda x: motion_at_end(x - centre).value, 64, 64)
        for way in (errors.morph_to_shape, errors.shape_to_morph):
            assert way == pytest.approx((0.05, 0.05, 0.05), abs=1e-3)
        assert errors.chamfer == pytest.approx(0.05, abs=1e-3)
        assert errors.hausdorff == pytest.approx(0.05, abs=1e-3)
        assert errors.normal_error < 1
        assert errors.volume_error == pytest.approx((0.40 / 0.45) ** dim - 1, abs=1e-3)


def test_normals_of_a_disk_beside_its_place():
    """At angle φ the nearest normal differs by 0.05 |sin φ| / 0.4, whose mean is 2/π of the greatest."""
    motion = MOTIONS["translating_ball"](2)
    errors = endpoint_errors(motion, 0.0, lambda x: motion.source(x - x.new_tensor([0.05, 0])), 64)
    assert errors.normal_error == pytest.approx(math.degrees(0.05 / 0.4 * 2 / math.pi), rel=0.02)


def test_edges_of_a_mesh_are_sharp_in_its_normals(tmp_path):
    """A morph that is the mesh itself has its normals next to edges too, where differences would mix two of them."""
    trimesh.creation.icosphere(subdivisions=1).export(tmp_path / "ball.obj")
    shape = MeshFile(str(tmp_path / "ball.obj"), fit=0.5)

    class Mesh(Still):
        def gradient(self, x, t):
            return shape.jet(x).gradient

    assert endpoint_errors(Mesh(3, lambda x, t: shape(x)), 0.0, shape, 32, 16).normal_error < 1e-4


def test_angles_are_exact_where_they_are_small():
    a = torch.tensor([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]], dtype=torch.float32)
    b = torch.tensor([[1.0, 1e-5], [0.0, 1.0], [-1.0, 0.0]], dtype=torch.float32)
    assert angles(a, b) == pytest.approx(torch.tensor([1e-5, math.pi / 2, math.pi]), rel=1e-4)
