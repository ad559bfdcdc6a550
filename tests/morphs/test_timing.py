"""Timings of the configuration, and the morphs that follow them."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf
from problems import growing_ball, squashed_ball

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.geometry.advection import advect
from nsm.io.timing import build_timing, read_timing
from nsm.morphs.exact_ends import ExactEnds
from nsm.morphs.growth import Grown, VolumeLinear
from nsm.morphs.timing import EaseIn, EaseOut, Retimed, Smooth, Table, Timing

PAIRS = [[0, 0], [0.2, 0.1], [0.4, 0.5], [0.6, 0.5], [1, 1]]
NAMES = sorted(path.stem for path in (CONF / "timing").glob("*.yaml"))


def timing_of(name: str) -> Timing:
    if name == "table":
        return Table(PAIRS)
    return build_timing(OmegaConf.to_container(OmegaConf.load(CONF / "timing" / f"{name}.yaml")))


every_timing = pytest.mark.parametrize("name", [name for name in NAMES if name != "linear"])


@every_timing
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_timing_rises_from_exactly_0_to_exactly_1(name: str, dtype: torch.dtype) -> None:
    timing, s = timing_of(name), torch.linspace(0, 1, 1001, dtype=dtype)
    t = timing(s)
    assert (timing(0.0), timing(1.0)) == (0.0, 1.0)
    assert (t[0], t[-1]) == (0, 1)
    assert t.dtype == dtype
    assert (t.diff() >= -torch.finfo(dtype).eps).all()
    assert ((t >= 0) & (t <= 1)).all()
    assert [timing(float(each)) for each in s[::100]] == pytest.approx(t[::100].tolist(), abs=1e-6)


@every_timing
def test_the_rate_is_the_derivative(name: str) -> None:
    timing, step = timing_of(name), 1e-6
    s = torch.linspace(0, 1, 101, dtype=torch.double)  # the ends, too: a timing goes on beyond them
    slope = (timing(s + step) - timing(s - step)) / (2 * step)
    torch.testing.assert_close(timing.rate(s), slope, atol=2e-5, rtol=0)
    assert timing.rate(0.3) == pytest.approx(float(timing.rate(torch.tensor(0.3, dtype=torch.double))))


def test_the_formulas() -> None:
    s = torch.rand(20, dtype=torch.double)
    torch.testing.assert_close(Smooth()(s), 3 * s**2 - 2 * s**3)
    torch.testing.assert_close(EaseIn(2.5)(s), s**2.5)
    torch.testing.assert_close(EaseOut(2.5)(s), 1 - (1 - s) ** 2.5)
    torch.testing.assert_close(Table([[0, 0], [1, 1]])(s), s)
    torch.testing.assert_close(EaseIn(1)(s), s)


def test_a_table_passes_its_pairs_and_rests_where_they_do() -> None:
    table = Table(PAIRS)
    assert [table(s) for s, _ in PAIRS] == pytest.approx([t for _, t in PAIRS], abs=1e-15)
    for s in (0.4, 0.45, 0.5, 0.6):
        assert table(s) == 0.5
        assert table.rate(s) == 0


@pytest.mark.parametrize(
    "pairs",
    [
        [],
        [[0, 0]],
        [[0, 0], [0.5, 0.7], [0.8, 0.6], [1, 1]],
        [[0, 0], [0.5, 0.2], [0.5, 0.4], [1, 1]],
        [[0, 0.1], [1, 1]],
        [[0, 0], [1, 0.9]],
        [[0, 0], [0.5, 0.5, 0.5], [1, 1]],
    ],
)
def test_a_table_must_rise_from_0_to_1(pairs: list) -> None:
    with pytest.raises(InputError, match=r"`timing.pairs` must be .*Try `timing.pairs=\[\[0,0\],"):
        Table(pairs)


@pytest.mark.parametrize("power", [0.5, float("inf")])
def test_a_power_is_at_least_1(power: float) -> None:
    with pytest.raises(InputError, match=r"`timing.power` must be a .*number.*Try `timing.power=2`"):
        EaseIn(power)


def test_timings_are_read_by_name_or_as_pairs(tmp_path: Path) -> None:
    assert read_timing("linear") is None
    assert isinstance(read_timing("ease_out"), EaseOut)
    assert read_timing(PAIRS)(0.2) == pytest.approx(0.1)  # type: ignore[misc]
    with pytest.raises(InputError, match=r"`timing` must be one of ease_in, .*got smoth. Try `timing=smooth`"):
        read_timing("smoth")
    with pytest.raises(InputError, match=r"`timing` must have the arguments of .*Smooth, got others"):
        build_timing({"_target_": "nsm.morphs.timing.Smooth", "power": 2})


@every_timing
def test_a_retimed_morph_satisfies_the_level_set_equation_and_its_flow_is_that_of_the_morph(name: str) -> None:
    morph = squashed_ball(3)
    film = Retimed(morph, timing_of(name))
    x, s = torch.rand(40, 3, dtype=torch.double) - 0.5, torch.rand(40, dtype=torch.double)
    step = 1e-6
    rate = (film(x, s + step) - film(x, s - step)) / (2 * step)
    residual = rate + (film.gradient(x, s) * film.velocity(x, s)).sum(1)
    assert residual.abs().max() < 1e-4
    assert rate.abs().max() > 0.1
    arrived, expected = (advect(each.velocity, x[:5], [0.0, 1.0])[-1] for each in (film, morph))
    torch.testing.assert_close(arrived, expected, atol=2e-4, rtol=0)


def test_a_retimed_morph_is_the_morph_at_other_times() -> None:
    morph = Grown(growing_ball(2), VolumeLinear(2, 1.0, 2.0))
    film, x = Retimed(morph, Smooth()), torch.rand(9, 2, dtype=torch.double)
    torch.testing.assert_close(film(x, 0.25), morph(x, 0.15625))
    torch.testing.assert_close(film.velocity(x, 0.5), 1.5 * morph.velocity(x, 0.5))
    torch.testing.assert_close(film.divergence(x, 0.5), 1.5 * morph.divergence(x, 0.5))
    assert film.wanted_volume(0.25) == morph.wanted_volume(0.15625)
    torch.testing.assert_close(film.domain(0.25), morph.domain(0.15625))
    with pytest.raises(InputError, match=r"`timing` must be linear .*got Smooth. Try `timing=linear`"):
        film.networks()


@every_timing
def test_the_keys_of_a_film_are_shown_when_the_morph_passes_them(name: str) -> None:
    timing = timing_of(name)
    assert [key.time for key in Retimed(squashed_ball(2), timing).keys] == [0, 1]
    for t in (0.1, 0.5, 0.83):
        assert timing(timing.inverse(t)) == pytest.approx(t, abs=1e-12)


def test_exact_ends_stay_exact() -> None:
    morph, x = ExactEnds(squashed_ball(2)), torch.rand(9, 2, dtype=torch.double)
    film = Retimed(morph, Table(PAIRS))
    assert (film(x, 0.0) == morph.source(x)).all()
    assert (film(x, 1.0) == morph.target(x)).all()
