"""Batches: their composition, the distribution of their points, and reproducibility."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import pytest
import torch

from nsm.cli.errors import InputError
from nsm.sampling import Batch, Box, EndSurfaces, Fractions, MorphSampler, MovingSurface, Pools, SdfSampler, UniformTime
from nsm.train.tasks.data import FieldData, _generator, _Stream
from nsm.types import DistanceSamples, Jet, Key, SurfaceSamples


def pools(offset: float, dim: int = 2, count: int = 50) -> Pools:
    """Known points that tell where they come from: their first coordinate is the offset, the second their number."""
    points = torch.full((count, dim), offset)
    points[:, 1] = torch.arange(count) / count
    return Pools(SurfaceSamples(points, points + 10), DistanceSamples(points + 100, points[:, 1] + offset))


def morph_sampler(size: int = 40, fractions: Fractions | None = None, dim: int = 2) -> MorphSampler:
    time = UniformTime(-0.2, 1.0)
    return MorphSampler(
        {0.0: pools(1.0, dim), 1.0: pools(2.0, dim)}, Box(dim, 1.5), time, size, fractions or Fractions()
    )


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize("size", [1, 2, 3, 7, 40, 5000])
@pytest.mark.parametrize("fractions", [(0.25, 0.25), (0.4, 0.5), (1.0, 0.0), (0.0, 0.0), (0.5, 0.5), (0.3, 0.7)])
def test_the_parts_of_a_batch_add_up(size: int, fractions: tuple[float, float]) -> None:
    counts = Fractions(*fractions).counts(size)
    assert sum(counts) == size
    assert min(counts) >= 0
    assert all(abs(n - f * size) <= 1 for n, f in zip(counts, fractions, strict=False))


@pytest.mark.parametrize(("surface", "ambient"), [(0.8, 0.8), (-0.1, 0.5), (0.5, -0.1), (float("nan"), 0.1)])
def test_fractions_must_be_non_negative_with_a_sum_of_at_most_one(surface: float, ambient: float) -> None:
    with pytest.raises(InputError, match=r"`sampler.fractions` must be .*, got surface=.* Try"):
        Fractions(surface, ambient)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_batch_is_surface_then_ambient_then_interior(dim: int) -> None:
    batch = morph_sampler(40, dim=dim).draw(seeded())
    assert batch.points.shape == (40, dim + 1)
    assert batch.normals.shape == (10, dim)
    assert batch.distances.shape == (20,)
    assert (batch.surface, batch.ambient, batch.interior) == (slice(0, 10), slice(10, 20), slice(20, 40))


def test_half_of_the_known_points_come_from_each_end_and_carry_its_time() -> None:
    batch = morph_sampler(40).draw(seeded())
    for part, shift in ((batch.surface, 0), (batch.ambient, 100)):
        where, when = batch.points[part, 0] - shift, batch.points[part, 2]
        assert where.tolist() == [1.0] * 5 + [2.0] * 5
        assert when.tolist() == [0.0] * 5 + [1.0] * 5


def test_an_odd_number_of_known_points_gives_the_source_one_more() -> None:
    batch = morph_sampler(20, Fractions(0.25, 0.0)).draw(seeded())
    assert batch.points[batch.surface, 2].tolist() == [0, 0, 0, 1, 1]


def test_targets_stay_with_their_points() -> None:
    batch = morph_sampler(400).draw(seeded())
    on, around = batch.points[batch.surface, :2], batch.points[batch.ambient, :2]
    torch.testing.assert_close(batch.normals, on + 10)
    assert (batch.distances[batch.surface] == 0).all()
    torch.testing.assert_close(batch.distances[batch.ambient], around[:, 1] - 100 + around[:, 0] - 100)


def test_interior_points_fill_the_box_and_the_times() -> None:
    batch = morph_sampler(20000, Fractions(0.0, 0.0)).draw(seeded())
    x, t = batch.points[batch.interior, :2], batch.points[batch.interior, 2]
    assert -1.5 <= x.min() < -1.49
    assert 1.49 < x.max() <= 1.5
    assert -0.2 <= t.min() < -0.19
    assert 0.99 < t.max() <= 1.0
    assert x.mean().abs() < 0.03
    assert float(t.mean()) == pytest.approx(0.4, abs=0.01)


def test_a_still_shape_has_points_of_space_alone() -> None:
    batch = SdfSampler(pools(1.0), Box(2, 1.0), 40, Fractions(0.25, 0.25)).draw(seeded())
    assert batch.points.shape == (40, 2)
    assert (batch.points[batch.surface, 0] == 1).all()
    torch.testing.assert_close(batch.normals, batch.points[batch.surface] + 10)
    assert batch.points[batch.interior].abs().max() <= 1


def test_the_same_state_draws_the_same_batch_and_the_next_state_another() -> None:
    sampler, generator = morph_sampler(), seeded()
    first, second = sampler.draw(generator), sampler.draw(generator)
    again = sampler.draw(seeded())
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not torch.equal(first.points, second.points)


def test_a_batch_depends_on_seed_rank_and_step_alone() -> None:
    sampler = morph_sampler()
    keys = [(0, 0, 0), (0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 1, 1), (1, 1, 0)]
    batches = {key: sampler.draw(_generator(*key)).points for key in keys}
    for key, points in batches.items():
        assert torch.equal(points, sampler.draw(_generator(*key)).points)
        assert not any(torch.equal(points, other) for k, other in batches.items() if k != key)


def stream(rank: int = 0, step: int = 0, accumulate: int = 1) -> list[torch.Tensor]:
    trainer = SimpleNamespace(global_rank=rank, global_step=step, accumulate_grad_batches=accumulate)
    batches = iter(_Stream.__iter__(SimpleNamespace(sampler=morph_sampler(), seed=0, trainer=trainer)))  # type: ignore[arg-type]
    return [next(batches).points for _ in range(4)]


def test_ranks_see_different_points() -> None:
    assert not any(torch.equal(a, b) for a in stream(rank=0) for b in stream(rank=1))


def test_a_resumed_stream_continues_where_it_stopped() -> None:
    assert all(torch.equal(a, b) for a, b in zip(stream()[2:], stream(step=2)[:2], strict=True))
    assert all(torch.equal(a, b) for a, b in zip(stream()[2:], stream(step=1, accumulate=2)[:2], strict=True))


def test_validation_sees_one_batch_that_never_changes() -> None:
    data = FieldData(morph_sampler(), morph_sampler(), seed=3)
    first, again = list(data.val_dataloader()), list(data.val_dataloader())
    assert len(first) == 1
    assert isinstance(first[0], Batch)
    assert torch.equal(first[0].points, again[0].points)
    other = list(FieldData(morph_sampler(), morph_sampler(), seed=4).val_dataloader())
    assert not torch.equal(first[0].points, other[0].points)


def test_a_box_must_contain_the_shapes() -> None:
    with pytest.raises(InputError, match=r"`sampler.box.half_width` must be at least 1 .*, got 0.5. Try"):
        Box(3, 0.5)


@pytest.mark.parametrize(("start", "stop"), [(1.0, 0.0), (0.5, 0.5), (float("nan"), 1.0)])
def test_the_start_must_precede_the_stop(start: float, stop: float) -> None:
    with pytest.raises(InputError, match=r"`sampler.time.start` must be less than .*, got .* Try"):
        UniformTime(start, stop)


def moving(fraction: float = 0.3, dim: int = 2) -> MovingSurface:
    return MovingSurface(dim, interior=200, fraction=fraction, width=0.08, reach=0.25)


def disk_jet(p: torch.Tensor) -> Jet:
    """A disk of radius ½ that moves to the right."""
    x = p[:, :2] - torch.stack([0.3 * p[:, 2], 0 * p[:, 2]], 1)
    return Jet(x.norm(dim=1) - 0.5, torch.cat([x / x.norm(dim=1, keepdim=True), 0 * p[:, 2:]], 1))


def two_disks_jet(p: torch.Tensor) -> Jet:
    """The same, and at a distance a small disk that stands still."""
    large, x = disk_jet(p), p[:, :2] - torch.tensor([-1.1, -1.1])
    small = Jet(x.norm(dim=1) - 0.2, torch.cat([x / x.norm(dim=1, keepdim=True), 0 * p[:, 2:]], 1))
    nearer = small.value < large.value
    return Jet(
        torch.where(nearer, small.value, large.value), torch.where(nearer[:, None], small.gradient, large.gradient)
    )


def after_steps(near: MovingSurface, count: int, jet: Callable[[torch.Tensor], Jet], first: int = 0) -> Batch:
    """The last batch of some steps in which the surface is followed."""
    sampler = morph_sampler(400)
    for step in range(first, first + count):
        batch = near.place(sampler.draw(_generator(0, 0, step)), 1.5)
        near.follow(batch, jet(batch.points[batch.interior]))
    return batch


def test_the_first_batch_is_as_it_was_drawn() -> None:
    batch = morph_sampler(400).draw(seeded())
    assert moving().place(batch, 1.5).points is batch.points


def test_interior_points_follow_the_surface_and_stay_near_it() -> None:
    near = moving()
    batch = after_steps(near, 5, disk_jet)
    drawn = morph_sampler(400).draw(_generator(0, 0, 4))
    changed = (batch.points != drawn.points).any(1)
    assert changed[batch.interior].sum() == 60
    assert not changed[: batch.ambient.stop].any()
    placed = disk_jet(batch.points[changed])
    assert placed.value.abs().max() <= 0.08 * 2**0.5 + 1e-6
    assert placed.value.abs().mean() > 0.01
    torch.testing.assert_close(disk_jet(near.points).value, torch.zeros(60), atol=1e-6, rtol=0)


def test_points_near_the_surface_have_fresh_times() -> None:
    near = moving()
    after_steps(near, 20, disk_jet)
    before = near.points[:, -1].clone()
    assert len(before.unique()) == 60
    after_steps(near, 20, disk_jet, first=20)
    assert not torch.isin(near.points[:, -1], before).any()


def test_a_component_that_appears_elsewhere_is_found() -> None:
    near = moving()
    after_steps(near, 20, disk_jet)
    assert (near.points[:, :2] > -0.7).all()
    after_steps(near, 40, two_disks_jet, first=20)
    assert (near.points[:, :2] < -0.7).all(1).any()


def test_points_stay_where_no_surface_is_in_reach() -> None:
    near = moving()
    after_steps(near, 5, disk_jet)
    before = near.points.clone()
    after_steps(near, 5, lambda p: Jet(torch.ones(len(p)), torch.ones(len(p), 3)))
    assert torch.equal(near.points, before)


def test_without_a_fraction_nothing_moves() -> None:
    near = moving(0.0)
    batch = after_steps(near, 5, disk_jet)
    assert torch.equal(batch.points, morph_sampler(400).draw(_generator(0, 0, 4)).points)


@pytest.mark.parametrize("fraction", [-0.1, 1.1, float("nan")])
def test_a_fraction_must_lie_between_0_and_1(fraction: float) -> None:
    with pytest.raises(InputError, match=r"`sampler.near.fraction` must be .* got .* Try"):
        moving(fraction)
    with pytest.raises(InputError, match=r"`sampler.ends.own` must be .* got .* Try"):
        EndSurfaces(2, 100, fraction, 0.25, 0.05, 0.1)


def with_leftover(count: int) -> tuple[EndSurfaces, Batch, torch.Tensor]:
    """f holds a second disk at both ends, far from the shape: the last of some batches, and which points it placed."""
    ends, near = EndSurfaces(2, ambient=200, own=0.5, visitors=0.2, width=0.05, reach=0.25), moving()
    sampler = MorphSampler(disk_pools(), Box(2, 1.5), UniformTime(), 400, Fractions(0.25, 0.5))
    for step in range(count):
        drawn = near.place(sampler.draw(_generator(0, 0, step)), 1.5)
        batch = ends.place(drawn, near, 1.5, [Key(0.0, disk_at_start), Key(1.0, disk_at_end)])
        near.follow(batch, two_disks_jet(batch.points[batch.interior]))
        ends.follow(batch, two_disks_jet(batch.points))
    return ends, batch, (batch.points != drawn.points).any(1).nonzero()[:, 0]


def test_ambient_points_on_the_surface_of_f_carry_their_distance_to_the_shape() -> None:
    ends, batch, changed = with_leftover(10)
    assert torch.equal(changed, (batch.ambient.start + ends.chosen).sort().values)
    x, when = batch.points[: batch.ambient.stop, :2], batch.points[: batch.ambient.stop, -1]
    assert torch.equal(when, when.round())
    expected = torch.where(when < 0.5, disk_at_start(x), disk_at_end(x))[batch.ambient]
    torch.testing.assert_close(batch.distances[batch.ambient], expected)
    torch.testing.assert_close(two_disks_jet(ends.points).value, torch.zeros(100), atol=1e-5, rtol=0)


def test_half_of_the_points_on_the_surface_of_f_stay_on_spurious_components() -> None:
    ends, batch, _ = with_leftover(10)
    left_over = batch.distances[batch.ambient][ends.chosen[:100]] > 0.3
    assert 0.45 < left_over.float().mean() < 0.8
    assert set(ends.points[:, -1].tolist()) == {0.0, 1.0}


def disk_at_start(x: torch.Tensor) -> torch.Tensor:
    return disk_jet(torch.cat([x, torch.zeros(len(x), 1)], 1)).value


def disk_at_end(x: torch.Tensor) -> torch.Tensor:
    return disk_jet(torch.cat([x, torch.ones(len(x), 1)], 1)).value


def disk_pools() -> dict[float, Pools]:
    points = 3 * torch.rand(2000, 2, generator=seeded()) - 1.5
    return {
        time: Pools(SurfaceSamples(points, points), DistanceSamples(points, shape(points)))
        for time, shape in ((0.0, disk_at_start), (1.0, disk_at_end))
    }
