"""Plan of a study: every pair with every method, once per seed."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.cli.settings import invalid, nearest, positive, whole_number
from nsm.io.loading import known_ends
from nsm.io.official import PAIRS
from nsm.metrics import Protocol

#: Valid name of a pair or method; folders and files are named after it.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*")
#: Name of the row of the authors' morphs.
OFFICIAL = "official"


class Choice(NamedTuple):
    """A pair or a method of a study.

    Attributes:
        name: Name of its column or row, and of its folder.
        file: Name of its file in ``conf/experiment`` or ``conf/method``.
        overrides: Further overrides of ``python -m nsm.train``.
    """

    name: str
    file: str
    overrides: tuple[str, ...]


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


class Study(NamedTuple):
    """A study as its configuration describes it.

    Attributes:
        name: Name of the study.
        pairs: Pairs of shapes.
        methods: Methods, each of which is run on every pair.
        seeds: Seeds, from each of which every method is run on every pair.
        overrides: Overrides of every run.
        budget: Budget of every run.
        threads: Threads of one run and of the evaluation; None takes all cores.
        official: Whether the authors' morphs are a row too, where they published one.
        ends: Ends of the evaluated morphs, ``exact`` or ``network``.
        protocol: Protocol of the evaluation.
        folder: Folder of the study.
    """

    name: str
    pairs: tuple[Choice, ...]
    methods: tuple[Choice, ...]
    seeds: tuple[int, ...]
    overrides: tuple[str, ...]
    budget: Budget
    threads: int | None
    official: bool
    ends: str
    protocol: Protocol
    folder: Path


class Job(NamedTuple):
    """One run of a study.

    Attributes:
        pair: Name of the pair.
        method: Name of the method.
        seed: Seed.
        overrides: All overrides of ``python -m nsm.train``.
        folder: Folder of the run.
    """

    pair: str
    method: str
    seed: int
    overrides: tuple[str, ...]
    folder: Path

    @property
    def name(self) -> str:
        """Short name, as progress and logs show it."""
        return f"{self.pair}/{self.method}" + (f"/{self.folder.name}" if self.folder.name != self.method else "")


def read_study(config: Mapping[str, Any]) -> Study:
    """Read a study from the configuration of ``conf/compare.yaml``.

    Raises:
        InputError: If a name is unknown or repeated, or a setting is not valid.
    """
    seeds = tuple(config["seeds"])
    if not seeds or len(set(seeds)) < len(seeds) or not all(type(seed) is int for seed in seeds):
        raise invalid("seeds", "a list of different integers", list(seeds), "[0,1]")
    protocol = {name: whole_number(name, config[name], least) for name, least in _LEAST.items()}
    return Study(
        str(config["name"]),
        _choices("pairs", "experiment", config["pairs"]),
        _choices("methods", "method", config["methods"]),
        seeds,
        tuple(config["overrides"]),
        _budget(config["minutes"], config["steps"]),
        None if config["threads"] is None else whole_number("threads", config["threads"]),
        bool(config["official"]),
        known_ends(config["ends"]),
        Protocol(**protocol),
        Path(config["output"]),
    )


#: Least valid value of each setting of the evaluation.
_LEAST = {"volume_resolution": 8, "surface_resolution": 8, "times": 2}


def jobs(study: Study) -> list[Job]:
    """List all runs, seed by seed and pair by pair, so that a study that is stopped has complete rows of pictures."""
    return [_job(study, pair, method, seed) for seed in study.seeds for pair in study.pairs for method in study.methods]


def official_pair(pair: Choice) -> str | None:
    """Name of the published morph between the shapes of a pair; None if there is none."""
    return pair.file if pair.file in PAIRS else None


def _job(study: Study, pair: Choice, method: Choice, seed: int) -> Job:
    folder = study.folder / "runs" / pair.name / method.name
    overrides = (
        f"+experiment={pair.file}",
        f"method={method.file}",
        *study.overrides,
        *pair.overrides,
        *method.overrides,
        f"seed={seed}",
    )
    return Job(pair.name, method.name, seed, overrides, folder / f"seed_{seed}" if len(study.seeds) > 1 else folder)


def _choices(key: str, group: str, entries: Sequence[Any]) -> tuple[Choice, ...]:
    found = tuple(_choice(key, group, entry) for entry in entries or ())
    names = [choice.name for choice in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        first = twice[0]
        other = f"[{first},{{name: {first}_2, {group}: {first}}}]"
        raise invalid(key, "a list of entries with different names", f"{', '.join(twice)} twice", other)
    if not found:
        studies = " or ".join(f"`+study={study}`" for study in _known("study"))
        raise InputError(f"`{key}` must be a list of some of {', '.join(_known(group))}, got []. Try {studies}.")
    return found


def _choice(key: str, group: str, entry: Any) -> Choice:
    """Read an entry; a name alone stands for the file of that name."""
    given = {"name": entry} if isinstance(entry, str) else dict(entry)
    name = str(given.get("name") or given.get(group, ""))
    file = str(given.get(group, name))
    known = _known(group)
    example = nearest(file, known) or known[0]
    if unknown := set(given) - {"name", group, "overrides"}:
        keys = f"a list of entries with the keys name, {group}, and overrides only"
        raise invalid(key, keys, ", ".join(sorted(unknown)), f"[{{name: own, {group}: {example}}}]")
    if file not in known:
        raise invalid(key, f"a list of some of {', '.join(known)}", file, f"[{example}]")
    if not _NAME.fullmatch(name) or name == OFFICIAL:
        names = f"a list of entries whose names have letters, digits, and _ only and differ from {OFFICIAL}"
        raise invalid(key, names, name, f"[{{name: own, {group}: {example}}}]")
    return Choice(name, file, tuple(given.get("overrides") or ()))


def _known(group: str) -> list[str]:
    return sorted(file.stem for file in (CONF / group).glob("*.yaml"))


def _budget(minutes: Any, steps: Any) -> Budget:
    if minutes is not None and steps is not None:
        raise InputError(
            f"`minutes` must be null where `steps` is given, got minutes={minutes} and steps={steps}. "
            f"Try `minutes=null steps={steps}`."
        )
    if minutes is None:
        return Budget(None, None if steps is None else whole_number("steps", steps, example=1000))
    return Budget(positive("minutes", minutes, 8), None)
