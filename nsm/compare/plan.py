"""What a study consists of: every pair with every method, once for each seed."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.cli.settings import whole_number
from nsm.io.loading import known_ends
from nsm.io.official import PAIRS
from nsm.metrics import Protocol

#: What the name of a pair or of a method may be made of, since folders and files are called after it.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*")
#: The name of the row of the authors' morphs.
OFFICIAL = "official"


class Choice(NamedTuple):
    """A pair or a method of a study.

    Attributes:
        name: of its column or row, and of its folder.
        file: in ``conf/experiment`` or ``conf/method``.
        overrides: of ``python -m nsm.train``, beside that file.
    """

    name: str
    file: str
    overrides: tuple[str, ...]


class Budget(NamedTuple):
    """What each run may take: minutes of training, a number of steps, or, if both are None, the steps of its recipe."""

    minutes: float | None
    steps: int | None

    def __str__(self) -> str:
        if self.minutes:
            return f"{self.minutes:g} minutes of training"
        return f"{self.steps} steps" if self.steps else "the recipe's own number of steps"


class Study(NamedTuple):
    """A study, as its configuration gives it.

    Attributes:
        name: of the study.
        pairs, methods, seeds: what is crossed.
        overrides: of every run.
        budget: of every run.
        threads: of one run and of the evaluation; None takes all cores.
        official: whether the authors' morphs are a row too, where they published one.
        ends: of each run, ``exact`` or ``network``.
        protocol: of the evaluation.
        folder: where everything goes.
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
    """One run of a study: of which pair, by which method, from which seed, with which overrides, in which folder."""

    pair: str
    method: str
    seed: int
    overrides: tuple[str, ...]
    folder: Path

    @property
    def name(self) -> str:
        """Short, for a line of progress."""
        return f"{self.pair}/{self.method}" + (f"/{self.folder.name}" if self.folder.name != self.method else "")


def read_study(config: Mapping[str, Any]) -> Study:
    """The study that a configuration of ``conf/compare.yaml`` describes.

    Raises:
        InputError: for names that no file has, or that come twice, and for settings that cannot be.
    """
    seeds = tuple(config["seeds"])
    if not seeds or len(set(seeds)) < len(seeds) or not all(type(seed) is int for seed in seeds):
        raise InputError(f"seeds={list(seeds)} are not to be drawn from: give whole numbers, each once, as seeds=[0,1]")
    protocol = {name: whole_number(name, config[name], least) for name, least in _LEAST.items()}
    return Study(
        str(config["name"]),
        _choices("pairs", "experiment", config["pairs"]),
        _choices("methods", "method", config["methods"]),
        seeds,
        tuple(config["overrides"]),
        _budget(config["minutes"], config["steps"]),
        None if config["threads"] is None else whole_number("threads", config["threads"], 1),
        bool(config["official"]),
        known_ends(config["ends"]),
        Protocol(**protocol),
        Path(config["output"]),
    )


#: The least that each setting of the evaluation may be.
_LEAST = {"volume_resolution": 8, "surface_resolution": 8, "times": 2}


def jobs(study: Study) -> list[Job]:
    """All runs: one seed of everything first, and of that pair by pair, so that pictures are complete early."""
    return [_job(study, pair, method, seed) for seed in study.seeds for pair in study.pairs for method in study.methods]


def official_pair(pair: Choice) -> str | None:
    """The published morph between the shapes of a pair, if there is one."""
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
        raise InputError(f"{key} has {', '.join(twice)} twice: give each a name of its own")
    if not found:
        studies = " or ".join(f"+study={study}" for study in _known("study"))
        raise InputError(f"{key}=[] leaves nothing to compare: give {studies}, or some of {', '.join(_known(group))}")
    return found


def _choice(key: str, group: str, entry: Any) -> Choice:
    """A name alone means the file of that name."""
    given = {"name": entry} if isinstance(entry, str) else dict(entry)
    name = str(given.get("name") or given.get(group, ""))
    file = str(given.get(group, name))
    if unknown := set(given) - {"name", group, "overrides"}:
        raise InputError(f"{key} has an entry with {', '.join(sorted(unknown))}: give name, {group} and overrides only")
    known = _known(group)
    if file not in known:
        near = get_close_matches(file, known, n=1)
        hint = f" (did you mean {near[0]}?)" if near else ""
        raise InputError(f"{key} has {file}, which is no {group} of nsm: give some of {', '.join(known)}{hint}")
    if not _NAME.fullmatch(name) or name == OFFICIAL:
        raise InputError(
            f"{key} has the name {name!r}, which no folder of a run can have: give one of letters, digits and _"
        )
    return Choice(name, file, tuple(given.get("overrides") or ()))


def _known(group: str) -> list[str]:
    return sorted(file.stem for file in (CONF / group).glob("*.yaml"))


def _budget(minutes: Any, steps: Any) -> Budget:
    if minutes is not None and steps is not None:
        raise InputError(
            f"`minutes` and `steps` must not both be given, got minutes={minutes} and steps={steps}. Try minutes=null "
            f"steps={steps}, or both null for the recipe's own number of steps."
        )
    if minutes is None:
        return Budget(None, None if steps is None else whole_number("steps", steps, 1))
    if isinstance(minutes, bool) or not isinstance(minutes, int | float) or not 0 < minutes < float("inf"):
        raise InputError(f"minutes={minutes} is no time to train in: give a number above 0")
    return Budget(float(minutes), None)
