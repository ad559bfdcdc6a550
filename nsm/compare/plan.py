"""Plan of a study: every pair with every method, once per seed."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from nsm.cli.errors import InputError
from nsm.cli.settings import invalid
from nsm.compare.choices import Choice, read_choices
from nsm.compare.printed import Printed, read_printed
from nsm.io.official import PAIRS
from nsm.metrics import Protocol
from nsm.train.consistency import effective, overridden

#: Learning rates by the names of a pair and a method.
Rates = Mapping[tuple[str, str], float]


class Budget(NamedTuple):
    """Budget of each run: minutes of training, a number of steps, or, if both are None, the steps of the recipe.

    Attributes:
        minutes: Minutes of training.
        steps: Number of steps.
    """

    minutes: float | None
    steps: int | None

    def __str__(self) -> str:
        if self.minutes:
            return f"{self.minutes:g} minutes of training"
        return f"{self.steps} steps" if self.steps else "the recipe's own number of steps"


class Slices(NamedTuple):
    """Slices of the residuals through changes of topology.

    Attributes:
        changes: Number of changes per morph that are drawn and listed, the first ones; 0 for none.
        axis: Axis perpendicular to the slices in 3D.
    """

    changes: int
    axis: str


class Study(NamedTuple):
    """A study as its configuration describes it.

    Attributes:
        name: Name of the study.
        pairs: Pairs of shapes.
        methods: Methods, each of which is run on every pair.
        seeds: Seeds, from each of which every method is run on every pair.
        learning_rates: Learning rates, of which each method gets its own best on each pair; empty for the recipe's.
        overrides: Overrides of every run; those that the task of a method does not use are left out of its runs.
        budget: Budget of every run.
        threads: Threads of one run and of the evaluation; None takes all cores.
        official: Whether the authors' morphs are a row too, where they published one.
        ends: Ends of the evaluated morphs, ``exact`` or ``network``.
        protocol: Protocol of the evaluation.
        slices: Slices through changes of topology.
        printed: Figures that the paper prints.
        folder: Folder of the study.
    """

    name: str
    pairs: tuple[Choice, ...]
    methods: tuple[Choice, ...]
    seeds: tuple[int, ...]
    learning_rates: tuple[float, ...]
    overrides: tuple[str, ...]
    budget: Budget
    threads: int | None
    official: bool
    ends: str
    protocol: Protocol
    slices: Slices
    printed: Printed
    folder: Path


class Job(NamedTuple):
    """One run of a study.

    Attributes:
        pair: Name of the pair.
        method: Name of the method.
        seed: Seed.
        overrides: All overrides of ``python -m nsm.train``.
        folder: Folder of the run.
        rate: Learning rate; None for that of the recipe.
        growth: Name of the change of volume with which the morph is evaluated.
    """

    pair: str
    method: str
    seed: int
    overrides: tuple[str, ...]
    folder: Path
    rate: float | None = None
    growth: str = "none"

    @property
    def name(self) -> str:
        """Short name, as progress and logs show it: pair, method, learning rate, and seed, as far as they vary."""
        rate = () if self.rate is None else (f"lr_{self.rate:g}",)
        seed = (self.folder.name,) if self.folder.name == f"seed_{self.seed}" else ()
        return "/".join((self.pair, self.method, *rate, *seed))


def read_study(config: Mapping[str, Any]) -> Study:
    """Read a study from the configuration of ``conf/compare.yaml``, whose types and ranges were checked before.

    Raises:
        InputError: If a name is unknown or repeated, or a setting is not valid.
    """
    seeds = tuple(config["seeds"])
    if not seeds or len(set(seeds)) < len(seeds) or not all(type(seed) is int for seed in seeds):
        raise invalid("seeds", "a list of different integers", list(seeds), "[0,1]")
    return Study(
        str(config["name"]),
        read_choices("pairs", "experiment", config["pairs"]),
        read_choices("methods", "method", config["methods"], ["growth"]),
        seeds,
        tuple(config["learning_rates"] or ()),
        tuple(config["overrides"]),
        _budget(config["minutes"], config["steps"]),
        config["threads"],
        config["official"],
        config["ends"],
        Protocol(*(config[name] for name in ("volume_resolution", "surface_resolution", "times", "samples"))),
        Slices(**config["slices"]),
        read_printed(config["paper"]),
        Path(config["output"]),
    )


def jobs(study: Study, rates: Rates | None = None) -> list[Job]:
    """List all runs, seed by seed and pair by pair, so that a study that is stopped has complete rows of pictures.

    Args:
        study: The study.
        rates: Learning rates that were chosen; a method without one has that of the recipe.
    """
    chosen = rates or {}
    return [
        _job(study, pair, method, seed, chosen.get((pair.name, method.name)))
        for seed in study.seeds
        for pair in study.pairs
        for method in study.methods
    ]


def trials(study: Study, trained: Collection[tuple[str, str]]) -> list[Job]:
    """List the runs that try each learning rate with the first seed.

    Args:
        study: The study.
        trained: Names of the pairs and methods that are trained in steps; others have no learning rate.
    """
    return [
        _job(study, pair, method, study.seeds[0], rate)
        for pair in study.pairs
        for method in study.methods
        for rate in study.learning_rates
        if (pair.name, method.name) in trained
    ]


def official_pair(pair: Choice) -> str | None:
    """Name of the published morph between the shapes of a pair; None if there is none."""
    return pair.file if pair.file in PAIRS else None


def _job(study: Study, pair: Choice, method: Choice, seed: int, rate: float | None) -> Job:
    folder = study.folder / "runs" / pair.name / method.name
    if rate is not None:
        folder /= f"lr_{rate:g}"
    overrides = (
        f"+experiment={pair.file}",
        f"method={method.file}",
        *effective(study.overrides, dict(overridden("method", method.file)).get("task", "morph")),
        *pair.overrides,
        *method.overrides,
        *(() if rate is None else (f"optimizer.lr={rate:g}",)),
        f"seed={seed}",
    )
    where = folder / f"seed_{seed}" if len(study.seeds) > 1 else folder
    return Job(pair.name, method.name, seed, overrides, where, rate, method.growth)


def _budget(minutes: float | None, steps: int | None) -> Budget:
    if minutes is not None and steps is not None:
        raise InputError(
            f"`minutes` must be null where `steps` is given, got minutes={minutes} and steps={steps}. "
            f"Try `minutes=null steps={steps}`."
        )
    return Budget(minutes, steps)
