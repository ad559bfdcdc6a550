"""The error of landmarks, on a rotation whose result is known."""

from __future__ import annotations

import math

import pytest
import torch
from analytic import shrinking, turning

from nsm.metrics.landmarks import landmark_errors
from nsm.morphs.exact_ends import ExactEnds
from nsm.morphs.file_coordinates import FileCoordinates
from nsm.morphs.growth import Grown, VolumeLinear
from nsm.morphs.neural import NeuralMorph
from nsm.shapes import Ball, LandmarkPairs

#: Angle by which the velocity turns, and distances of the targets from where it takes the landmarks.
SPIN, MISSED = 0.5, torch.tensor([0.0, 0.01, 0.05])


@pytest.fixture
def morph() -> NeuralMorph:
    """A source whose file is ten times as large as in the box, and landmarks of which two are missed."""
    made = turning(2, SPIN, Ball(4.0, [0.0, 0.0], pose={"scale": 0.1})).double()
    angle = torch.tensor([0.3, 1.0, 4.0], dtype=torch.double)
    source, arrived = (0.4 * torch.stack([a.cos(), a.sin()], 1) for a in (angle, angle + SPIN))
    target = arrived * (1 + MISSED[:, None] / 0.4)
    made.provenance = made.provenance | {"landmarks": LandmarkPairs(10 * source, target).provenance()}
    return made


def test_the_error_is_the_distance_from_where_the_velocity_takes_a_landmark(morph: NeuralMorph) -> None:
    for seen in (morph, ExactEnds(morph)):
        torch.testing.assert_close(landmark_errors(seen).float(), MISSED, atol=1e-5, rtol=0)


def test_the_error_is_in_the_coordinates_of_the_morph(morph: NeuralMorph) -> None:
    errors = landmark_errors(FileCoordinates(morph, "source"))
    torch.testing.assert_close(errors.float(), 10 * MISSED, atol=1e-4, rtol=0)
    grown = landmark_errors(Grown(morph, VolumeLinear(2, 1.0, 2.25)))
    torch.testing.assert_close(grown.float(), 1.5 * MISSED, atol=1e-4, rtol=0)


def test_there_is_none_without_landmarks_or_without_velocity(morph: NeuralMorph) -> None:
    assert landmark_errors(turning(2, SPIN)) is None
    still = shrinking(2, 0.1)
    still.provenance = morph.provenance
    assert landmark_errors(still) is None
    assert math.isclose(float(landmark_errors(morph).max()), 0.05, abs_tol=1e-5)
