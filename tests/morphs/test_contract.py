"""The contract of `nsm.types.Morph`, for every class that is one."""

from __future__ import annotations

import importlib
import inspect
import json
import pkgutil
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import NamedTuple

import pytest
import torch
from analytic import bowl, save, turning
from hydra.utils import instantiate
from problems import MOTIONS, squashed_ball
from runs import composed
from torch import Tensor

import nsm
from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.geometry.meshing import extract_surface
from nsm.io.official import load_official
from nsm.library import TrainedMorph
from nsm.morphs.exact_ends import ExactEnds
from nsm.morphs.exact_keys import ExactKeys
from nsm.morphs.file_coordinates import FileCoordinates
from nsm.morphs.growth import Grown, ScaleLinear, SmoothStep, Table, VolumeLinear
from nsm.morphs.leg import Leg
from nsm.morphs.neural import NeuralMorph
from nsm.morphs.optimal_transport import OptimalTransport
from nsm.morphs.timing import Retimed, Smooth
from nsm.shapes import Ball
from nsm.types import Morph

VELOCITIES = sorted(p.stem for p in (CONF / "velocity").glob("*.yaml"))
GROWTHS = {
    "volume_linear": lambda dim: VolumeLinear(dim, 1.5, 0.5),
    "scale_linear": lambda dim: ScaleLinear(dim, 0.5, 1.5),
    "smooth_step": lambda dim: SmoothStep(dim, 1.0, 1.5),
    "table": lambda dim: Table(dim, [0, 0.3, 1], [1.0, 1.4, 0.8]),
}
SMALL = (
    "network.velocity.hidden_features=8",
    "network.velocity.hidden_layers=2",
    "network.velocity.omega=2",
    "network.velocity.first_omega=2",
)
#: A disk whose file has other units and another orientation.
POSED = Ball(0.65, [0.0, 0.0], pose={"rotation": 90, "translation": [0.1, 0.2], "scale": 0.01})


class Case(NamedTuple):
    """A morph, how closely differences over a step give its derivatives, and whether it is made of networks."""

    make: Callable[[], Morph]
    step: float = 1e-5
    tolerance: float = 1e-5
    networks: bool = False


def neural(velocity: str, dim: int) -> NeuralMorph:
    """A morph of a known f, with a velocity of random weights."""
    torch.manual_seed(0)
    config = composed(f"velocity={velocity}", *SMALL).velocity
    made = instantiate(config, dim=dim, _convert_="all") if config else None
    middle = [0.0] * dim
    morph = NeuralMorph(bowl(dim, dim - 0.5, 0.1), made, Ball(0.65, middle), Ball(0.4, middle))
    return morph.double().requires_grad_(False)


def through_keys(dim: int) -> NeuralMorph:
    """The same through three balls."""
    morph, ball = neural("adadiv", dim), Ball(0.5, [0.0] * dim)
    keyed = NeuralMorph(morph.field, morph.velocity_field, morph.source, morph.target, 1.0, [ball], [0, 0.3, 1])
    return keyed.double().requires_grad_(False)


def optimal_transport(dim: int) -> Morph:
    method = OptimalTransport(points=6000, anchors=300, blur=0.1, scaling=0.7, kernel=0.07, resolution=32)
    return method.morph(Ball(0.4, [-0.4, 0.1, 0.0][:dim]), Ball(0.4, [0.4, -0.1, 0.2][:dim]), seed=0).double()


def library(dim: int) -> TrainedMorph:
    network = neural("adadiv", dim)
    return TrainedMorph(network, network, {}, "none")


CASES = {
    **{f"{name} {dim}D": Case(partial(MOTIONS[name], dim)) for name in MOTIONS for dim in (2, 3)},
    **{
        f"neural {name} {dim}D": Case(partial(neural, name, dim), networks=True)
        for name in VELOCITIES
        for dim in (2, 3)
    },
    **{
        f"grown {name}": Case(lambda growth=growth: Grown(squashed_ball(3), growth(3)))
        for name, growth in GROWTHS.items()
    },
    "grown neural": Case(lambda: Grown(neural("adadiv", 2), VolumeLinear(2, 1.0, 1.5)), networks=True),
    "grown without velocity": Case(lambda: Grown(neural("none", 2), VolumeLinear(2, 1.0, 1.5)), networks=True),
    "through keys": Case(lambda: through_keys(2), networks=True),
    "exact keys": Case(lambda: ExactKeys(through_keys(2))),
    "leg": Case(lambda: Leg(through_keys(2), 1)),
    "exact ends": Case(lambda: ExactEnds(turning(2, 0.5).double(), 12, 64)),
    "grown exact ends": Case(lambda: Grown(ExactEnds(turning(2, 0.5).double(), 12, 64), VolumeLinear(2, 1.0, 1.5))),
    "retimed": Case(lambda: Retimed(Grown(squashed_ball(3), VolumeLinear(3, 1.0, 1.5)), Smooth())),
    "retimed without velocity": Case(lambda: Retimed(neural("none", 2), Smooth())),
    "file coordinates": Case(lambda: FileCoordinates(turning(2, 0.5, POSED).double(), "source")),
    # its gradient is itself a difference, over two cells of a grid
    "optimal transport": Case(lambda: optimal_transport(2), 2 / 32, 0.05),
    "library": Case(lambda: library(2), networks=True),
}


@cache
def made(name: str) -> Morph:
    return CASES[name].make()


every_morph = pytest.mark.parametrize("name", CASES)


def points_and_times(morph: Morph, count: int = 60) -> tuple[Tensor, Tensor]:
    """Points in the box that is known at all times, and a time for each."""
    generator = torch.Generator().manual_seed(1)
    low, high = torch.stack([morph.domain(t) for t in (0.0, 0.5, 1.0)]).unbind(1)
    low, high = 0.9 * low.amax(0), 0.9 * high.amin(0)
    x = low + (high - low) * torch.rand(count, morph.dim, generator=generator, dtype=torch.double).to(low)
    return x, 0.1 + 0.8 * torch.rand(count, generator=generator, dtype=torch.double).to(low)


def jacobian(function: Callable[[Tensor], Tensor], x: Tensor, step: float) -> Tensor:
    """Central differences of values (n, m) at points, shape (n, m, d)."""
    steps = step * torch.eye(x.shape[1]).to(x)
    return torch.stack([(function(x + e) - function(x - e)) / (2 * step) for e in steps], -1)


@every_morph
def test_attributes(name: str) -> None:
    morph = made(name)
    assert isinstance(morph, Morph)
    assert morph.dim in (2, 3)
    assert morph.bounds.shape == (2, morph.dim)
    assert (morph.bounds[1] > morph.bounds[0]).all()
    x, _ = points_and_times(morph)
    times = [key.time for key in morph.keys]
    assert times == sorted(times)
    assert (times[0], times[-1]) == (0, 1)
    assert (morph.keys[0].shape, morph.keys[-1].shape) == (morph.source, morph.target)
    for shape in (key.shape for key in morph.keys):
        values = shape(x)
        assert values.shape == (len(x),)
        assert values.isfinite().all()


@every_morph
def test_provenance_is_plain(name: str) -> None:
    provenance = dict(made(name).provenance)
    assert json.loads(json.dumps(provenance)) == provenance
    assert set(provenance) <= {"source", "target", "landmarks"}


@every_morph
def test_shapes_and_types(name: str) -> None:
    morph = made(name)
    x, t = points_and_times(morph)
    for count in (len(x), 1):
        for times in (0.5, t[:count]):
            fields = [morph(x[:count], times), morph.gradient(x[:count], times)]
            fields += [field for f in (morph.velocity, morph.divergence) if (field := f(x[:count], times)) is not None]
            shapes = [(count,), (count, morph.dim), (count, morph.dim), (count,)]
            assert [tuple(field.shape) for field in fields] == shapes[: len(fields)]
            assert all(field.dtype == morph.bounds.dtype and field.isfinite().all() for field in fields)


@every_morph
def test_one_time_for_all_points_is_that_time_for_each(name: str) -> None:
    morph = made(name)
    x, _ = points_and_times(morph)
    each = torch.full_like(x[:, 0], 0.4)
    assert morph(x, 0.4) == pytest.approx(morph(x, each), abs=1e-6)
    assert morph.gradient(x, 0.4) == pytest.approx(morph.gradient(x, each), abs=1e-6)
    if morph.has_velocity:
        assert morph.velocity(x, 0.4) == pytest.approx(morph.velocity(x, each), abs=1e-6)
        assert morph.divergence(x, 0.4) == pytest.approx(morph.divergence(x, each), abs=1e-6)


@every_morph
def test_the_gradient_is_that_of_f(name: str) -> None:
    morph, step, tolerance = made(name), CASES[name].step, CASES[name].tolerance
    x, t = points_and_times(morph)
    slope = jacobian(lambda y: morph(y, t)[:, None], x, step)[:, 0]
    off = (slope - morph.gradient(x, t)).norm(dim=1)
    # a distance has creases, and an interpolant the planes between its cells
    assert (off < tolerance * (1 + slope.norm(dim=1))).double().mean() > 0.9


@every_morph
def test_the_divergence_is_that_of_the_velocity(name: str) -> None:
    morph, step, tolerance = made(name), CASES[name].step, CASES[name].tolerance
    x, t = points_and_times(morph)
    assert (morph.velocity(x, t) is not None) == (morph.divergence(x, t) is not None) == morph.has_velocity
    if morph.has_velocity:
        trace = jacobian(lambda y: morph.velocity(y, t), x, step).diagonal(dim1=1, dim2=2).sum(1)
        off = (trace - morph.divergence(x, t)).abs()
        assert (off < tolerance * (1 + trace.abs())).double().mean() > 0.9


@every_morph
def test_the_surface_lies_in_the_domain_and_the_domain_in_the_bounds(name: str) -> None:
    morph = made(name)
    slack = 1e-5
    for t in (0.0, 0.5, 1.0):
        low, high = morph.domain(t)
        assert (low >= morph.bounds[0] - slack).all()
        assert (high <= morph.bounds[1] + slack).all()
        vertices = extract_surface(partial(morph, t=t), morph.bounds, 24).vertices
        assert len(vertices) > 10
        assert (vertices >= low - slack).all()
        assert (vertices <= high + slack).all()


@every_morph
def test_the_wanted_volume_begins_at_the_initial_one_and_scales_with_it(name: str) -> None:
    morph = made(name)
    assert morph.wanted_volume(0.0, 0.7) == pytest.approx(0.7)
    for t in (0.0, 0.3, 1.0):
        relative = morph.wanted_volume(t)
        assert isinstance(relative, float)
        assert relative > 0
        assert morph.wanted_volume(t, 0.7) == pytest.approx(0.7 * relative)


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.networks])
def test_a_program_computes_what_the_morph_does(name: str) -> None:
    morph = made(name)
    x, t = points_and_times(morph)
    networks = morph.networks()
    described = json.loads(json.dumps(networks.description))
    assert described["dim"] == morph.dim
    assert torch.tensor(described["bounds"]) == pytest.approx(morph.bounds.float())
    assert (networks.weights is None) == ("grown" in name or "nise" in name)
    outputs = networks.program(x.float(), t.float())
    expected = [morph(x, t), morph.gradient(x, t), *([morph.velocity(x, t)] if morph.has_velocity else [])]
    assert len(outputs) == len(expected) == len(described["outputs"])
    for output, wanted in zip(outputs, expected, strict=True):
        assert output.double() == pytest.approx(wanted.double(), abs=1e-4)


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if not case.networks])
def test_what_is_not_made_of_networks_alone_has_no_program(name: str) -> None:
    with pytest.raises(InputError, match=r"must be (made of networks|linear for a format)"):
        made(name).networks()


def test_a_published_morph_keeps_the_contract(data_dir, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(CASES, "official", Case(lambda: load_official("twist").double(), 1e-5, 1e-4))
    for check in (test_attributes, test_provenance_is_plain, test_shapes_and_types, test_the_gradient_is_that_of_f):
        check("official")
    test_the_divergence_is_that_of_the_velocity("official")


def test_a_loaded_morph_knows_where_its_shapes_come_from(tmp_path) -> None:
    morph = turning(2, 0.5)
    provenance = {end: {**shape, "scale": 0.5} for end, shape in morph.provenance.items()}
    file = save(morph, tmp_path / "a.ckpt", provenance=provenance)
    assert nsm.load_morph(file).provenance == provenance


def test_every_class_that_is_a_morph_is_tested_here() -> None:
    for module in pkgutil.walk_packages(nsm.__path__, "nsm."):
        importlib.import_module(module.name)
    tested = {type(made(name)) for name in CASES}
    ours = {kind for kind in subclasses(Morph) if kind.__module__.startswith("nsm.") and not inspect.isabstract(kind)}
    assert ours - tested == set()


def subclasses(kind: type) -> Iterator[type]:
    for child in kind.__subclasses__():
        yield child
        yield from subclasses(child)
