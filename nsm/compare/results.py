"""Result of each run: its figures, which are measured once and kept, and the course of its training."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

import nsm
from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.compare.choices import OFFICIAL, Choice
from nsm.compare.logs import last_terms, read_course
from nsm.compare.plan import Job, Study, official_pair
from nsm.compare.record import DONE, FAILED, read_record
from nsm.io.checkpoint import find_checkpoint
from nsm.io.loading import PUBLISHED, LoadedMorph, load_published, load_run
from nsm.metrics import Protocol, all_metrics, evaluate_morph
from nsm.types import Morph

#: Called with the name of each stage as it begins.
OnStage = Callable[[str], object]


@dataclass(frozen=True)
class Result:
    """Result of a run or of an official morph.

    Attributes:
        pair: Name of the pair.
        method: Name of the method.
        seed: Seed; None for an official morph.
        reason: Reason why there are no figures; None if there are.
        figures: Figures of merit by name (`nsm.metrics.Evaluation.figures`).
        times: Times of the volume curve, k of them.
        volumes: Volume at each time.
        steps: Number of steps of training; None for a method in closed form.
        training_s: Seconds of training; None where unknown.
        step_s: Seconds per step; None where unknown.
        preparing_s: Seconds that the shapes took before training; None where unknown.
        terms: Weighted terms of the loss at the end of training.
        checkpoint: Checkpoint that was evaluated; for an official morph, its origin.
        ends: Ends of the morph, ``exact`` or ``network``.
        network_figures: Figures of the network alone where ``figures`` are those of the morph with exact ends; empty
            where ``figures`` are of the network already.
        rate: Learning rate that was chosen among several; None for that of the recipe.
        growth: Name of the change of volume of the morph, ``none`` for a constant one.
        events: Changes of topology, in order of time (`nsm.metrics.events.TopologyEvent` as a dict).
        course: Validations during training: steps before each, and figures by their name in the log.
    """

    pair: str
    method: str
    seed: int | None
    reason: str | None = None
    figures: dict[str, float | None] = field(default_factory=dict)
    times: list[float] = field(default_factory=list)
    volumes: list[float] = field(default_factory=list)
    steps: int | None = None
    training_s: float | None = None
    step_s: float | None = None
    preparing_s: float | None = None
    terms: dict[str, float] = field(default_factory=dict)
    checkpoint: str | None = None
    ends: str = "network"
    network_figures: dict[str, float | None] = field(default_factory=dict)
    rate: float | None = None
    growth: str = "none"
    events: list[dict[str, Any]] = field(default_factory=list)
    course: list[dict[str, float]] = field(default_factory=list)

    def morph(self) -> Morph:
        """Load the morph."""
        if self.checkpoint is None:
            raise ValueError(f"{self.method} made no morph of {self.pair}")
        official = self.checkpoint.removeprefix(PUBLISHED)
        if official != self.checkpoint:
            return load_published(official).morph
        return load_run(f"{self.pair}/{self.method}", Path(self.checkpoint), self.ends, _growth(self.growth)).morph


def result_of_run(study: Study, job: Job, progress: OnStage) -> Result:
    """Evaluate a run, unless its checkpoint has been evaluated under this protocol before."""
    bare = Result(job.pair, job.method, job.seed, ends=study.ends, rate=job.rate, growth=job.growth)
    record = read_record(job.folder)
    if record is None or record.state != DONE:
        state = record.state if record else "not started"
        retry = "; try it again with `retry=true`" if state == FAILED else ""
        unfinished = f"the run is {state}; repeat the command to resume it"
        return replace(bare, reason=record.reason + retry if record and record.reason else unfinished)
    timed = _timed(bare, job.folder)
    bare = replace(timed, steps=record.steps, terms=last_terms(job.folder), course=read_course(job.folder))
    try:
        file = find_checkpoint(job.folder)
        bare = replace(bare, checkpoint=str(file))
        key = {"checkpoint": hashlib.sha256(file.read_bytes()).hexdigest(), "ends": study.ends, "growth": job.growth}
        load = partial(load_run, job.name, file, study.ends, _growth(job.growth))
        return _evaluated(bare, job.folder, key, load, study.protocol, progress)
    except (InputError, OSError, ValueError, RuntimeError) as error:
        # one row must not end the study
        return replace(bare, reason=f"its morph could not be evaluated: {error}")


def result_of_official(study: Study, pair: Choice, progress: OnStage) -> Result:
    """Evaluate the authors' morph of a pair."""
    name = official_pair(pair)
    if name is None:
        return Result(pair.name, OFFICIAL, None, reason="the authors published no morph of this pair")
    bare = Result(pair.name, OFFICIAL, None, checkpoint=f"{PUBLISHED}{name}")
    folder, key = study.folder / "runs" / pair.name / OFFICIAL, {"checkpoint": bare.checkpoint}
    try:
        return _evaluated(bare, folder, key, partial(load_published, name), study.protocol, progress)
    except (InputError, OSError, ValueError, RuntimeError) as error:
        return replace(bare, reason=str(error))


def _evaluated(
    bare: Result,
    folder: Path,
    key: dict[str, Any],
    load: Callable[[], LoadedMorph],
    protocol: Protocol,
    progress: OnStage,
) -> Result:
    """Add the figures to a result, from ``evaluation.json`` if that has the same key."""
    # a version with other figures measures again
    names = hashlib.sha256("\n".join(metric.name for metric in all_metrics()).encode()).hexdigest()
    key = key | {"protocol": protocol.describe(), "version": nsm.__version__, "figures": names}
    file = folder / "evaluation.json"
    kept = _kept(file)
    if kept.get("key") != key:
        loaded = load()
        name = f"{bare.pair}/{bare.method}"
        flow_error = None if loaded.exact is None else loaded.exact.flow_error
        result = evaluate_morph(loaded.morph, protocol, lambda stage: progress(f"{name}: {stage}"), flow_error)
        network: dict[str, float | None] = {}
        if loaded.network is not None:
            without = evaluate_morph(loaded.network, protocol, lambda stage: progress(f"{name} (network): {stage}"))
            network = without.to_dict()["figures"]
        kept = {"key": key, **result.to_dict(), "network_figures": network}
        with atomic_write(file) as temporary:
            temporary.write_text(json.dumps(kept, indent=2) + "\n")
    curve = kept["volume"]
    volumes = [math.nan if v is None else v for v in curve["volumes"]]
    return replace(
        bare,
        figures=kept["figures"],
        network_figures=kept["network_figures"],
        events=kept["events"],
        times=curve["times"],
        volumes=volumes,
    )


def _growth(name: str) -> dict[str, Any]:
    """Configuration of a change of volume."""
    config: Any = OmegaConf.to_container(OmegaConf.load(CONF / "growth" / f"{name}.yaml"))
    return dict(config)


def _kept(file: Path) -> dict[str, Any]:
    """Read an evaluation; one that is missing or was cut is made again."""
    try:
        return dict(json.loads(file.read_text()))
    except (FileNotFoundError, ValueError):
        return {}


def _timed(bare: Result, folder: Path) -> Result:
    """Add the times that the run recorded; a method in closed form has only its summary."""
    summary = json.loads((folder / "summary.json").read_text())
    file = folder / "step_times.json"
    times = json.loads(file.read_text()) if file.is_file() else {}
    training = times.get("training_s", summary.get("training_s"))
    return replace(bare, training_s=training, step_s=times.get("step_s"), preparing_s=summary.get("preparing_s"))


def described(results: Iterable[Result]) -> list[dict[str, Any]]:
    """Convert results to values that JSON can hold."""
    return [
        {key: value for key, value in asdict(result).items() if key not in ("times", "volumes")}
        | {"volume": {"times": result.times, "volumes": [v if math.isfinite(v) else None for v in result.volumes]}}
        for result in results
    ]
