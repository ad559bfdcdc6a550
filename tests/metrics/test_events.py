"""Changes of topology at times and places that are known."""

from __future__ import annotations

import pytest
import torch
from measured import Still, meshes_of
from problems import MOTIONS

from nsm.metrics.events import TIME_TOLERANCE, topology_events


def two_balls(x, t):
    """Radius 0.3 about ±(0.5 − 0.35 t) e₁ from (0.1, 0.05, …): they touch there at t = 4/7."""
    shift = torch.zeros_like(x[:1])
    shift[0, 0] = 0.5 - 0.35 * t
    middle = torch.full_like(shift, 0.05) + torch.eye(x.shape[1], dtype=x.dtype)[:1] * 0.05
    return torch.minimum((x - middle - shift).norm(dim=1), (x - middle + shift).norm(dim=1)) - 0.3


def vanishing(x, t):
    """A ball stays, one of radius 0.3 (1 − t/0.62) about (0.5, 0.5, …) vanishes at t = 0.62."""
    return torch.minimum((x + 0.4).norm(dim=1) - 0.35, (x - 0.5).norm(dim=1) - 0.3 * (1 - t / 0.62))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    ("field", "time", "place"), [(two_balls, 4 / 7, (0.1, 0.05, 0.05)), (vanishing, 0.62, (0.5, 0.5, 0.5))]
)
def test_two_parts_become_one_when_and_where_they_do(field, time, place, dim):
    morph, times = Still(dim, field), [0.0, 0.5, 1.0]
    (event,) = topology_events(morph, times, meshes_of(morph, times, 64), 64)
    assert (event.components, event.genus) == ((2, 1), (0, 0))
    before, after = event.times
    assert after - before <= TIME_TOLERANCE
    # a ball or a gap smaller than a cell, 1/32, is not seen: it shrinks by 0.97 or 0.7 in a unit of time
    assert time - 1 / 32 / 0.7 < before < time + 0.002
    assert event.place == pytest.approx(place[:dim], abs=0.03)


def test_a_hole_that_closes_is_found_and_so_is_one_that_opens_again():
    """The tube of a torus reaches its middle, (0.1, −0.1, 0.05), at t = ¼ and leaves it at ¾."""
    middle = torch.tensor([0.1, -0.1, 0.05], dtype=torch.double)

    def torus(x, t):
        flat = x - middle
        ring = torch.stack([flat[:, :2].norm(dim=1) - 0.3, flat[:, 2]], 1)
        return ring.norm(dim=1) - 0.15 - 0.6 * min(t, 1 - t)

    morph, times = Still(3, torus), [0.0, 0.5, 1.0]
    closes, opens = topology_events(morph, times, meshes_of(morph, times, 48), 48)
    assert (closes.genus, opens.genus) == ((1, 0), (0, 1))
    assert closes.components == opens.components == (1, 1)
    for event, time in ((closes, 0.25), (opens, 0.75)):
        assert sum(event.times) / 2 == pytest.approx(time, abs=0.045)  # a gap below a cell, 1/24, is not seen
        assert event.place == pytest.approx(middle.tolist(), abs=0.03)


@pytest.mark.parametrize("name", ["growing_ball", "squashed_ball", "rotating_box"])
def test_motions_without_change_have_no_event(name):
    motion, times = MOTIONS[name](3), [0.0, 0.5, 1.0]
    assert topology_events(motion, times, meshes_of(motion, times, 32), 32) == ()
