"""Result of each run: the figures of its morph, and the course of its training."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from nsm.cli.errors import InputError
from nsm.compare.choices import OFFICIAL, Choice
from nsm.compare.logs import last_terms, read_course
from nsm.compare.measurement import Measurement, load_measured
from nsm.compare.plan import Job, Study, official_pair
from nsm.compare.record import DONE, FAILED, read_record
from nsm.io.checkpoint import find_checkpoint
from nsm.io.loading import PUBLISHED
from nsm.types import Morph

#: Beginning of the reason why a morph has no figures.
_UNMEASURED = "its morph could not be measured"


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
        return load_measured(f"{self.pair}/{self.method}", self.checkpoint, self.ends, self.growth).morph


def result_of_run(study: Study, job: Job) -> Result:
    """What is known of a run before its morph is measured; without a morph, the reason."""
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
        return replace(bare, checkpoint=str(find_checkpoint(job.folder)))
    except InputError as error:
        return replace(bare, reason=f"{_UNMEASURED}: {error}")


def result_of_official(study: Study, pair: Choice) -> tuple[Result, Path]:
    """The authors' morph of a pair before it is measured, or the reason why there is none; and its folder."""
    folder, name = study.folder / "runs" / pair.name / OFFICIAL, official_pair(pair)
    if name is None:
        return Result(pair.name, OFFICIAL, None, reason="the authors published no morph of this pair"), folder
    return Result(pair.name, OFFICIAL, None, checkpoint=f"{PUBLISHED}{name}"), folder


def measurement(study: Study, result: Result, folder: Path) -> Measurement | None:
    """The measurement of the morph of a result; None where there is no morph."""
    if result.checkpoint is None:
        return None
    name = folder.relative_to(study.folder / "runs").as_posix()
    published = result.checkpoint.startswith(PUBLISHED)
    # a worker may run in another folder
    origin = result.checkpoint if published else str(Path(result.checkpoint).resolve())
    return Measurement(name, folder, origin, result.ends, result.growth, study.protocol, study.threads)


def measured(result: Result, measurement: Measurement) -> Result:
    """Add the figures of its measurement to a result, or the reason why there are none."""
    kept = measurement.result()
    if "figures" not in kept:
        why = f": {kept['reason']}" if "reason" in kept else "; repeat the command to measure it"
        return replace(result, reason=_UNMEASURED + why)
    curve = kept["volume"]
    return replace(
        result,
        figures=kept["figures"],
        network_figures=kept["network_figures"],
        events=kept["events"],
        times=curve["times"],
        volumes=[math.nan if v is None else v for v in curve["volumes"]],
    )


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
