"""What came out of each run: its figures, measured once and kept, and how its training went."""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import nsm
from nsm.cli.errors import InputError
from nsm.cli.files import whole_file
from nsm.compare.plan import OFFICIAL, Choice, Job, Study, official_pair
from nsm.compare.record import DONE, FAILED, read_record
from nsm.io.loading import PUBLISHED, LoadedMorph, load_published, load_run
from nsm.metrics import Protocol, all_metrics, evaluate_morph
from nsm.types import Morph

#: Rows at the end of a log of which the mean is taken, since one batch alone is noisy.
_LAST_ROWS = 5
#: Is told what is being done.
Tell = Callable[[str], object]


@dataclass(frozen=True)
class Result:
    """A run, or an official morph, and what came out of it.

    Attributes:
        pair, method, seed: which; an official morph has no seed.
        reason: why there is nothing to compare; None if there is.
        figures: of quality, by name (`nsm.metrics.Evaluation.figures`).
        times, volumes: the volume curve, both (k,).
        steps: made.
        training_s, step_s, preparing_s: seconds; None where unknown.
        terms: the weighted terms of the loss at the end of training.
        checkpoint: the file that was looked at.
        ends: of the morph, ``exact`` or ``network``.
        network_figures: the same figures of the network alone, where ``figures`` are those of the morph with exact
            ends; empty where they are of the network already.
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

    def morph(self) -> Morph:
        """The morph itself, loaded anew."""
        if self.checkpoint is None:
            raise ValueError(f"{self.method} made no morph of {self.pair}")
        official = self.checkpoint.removeprefix(PUBLISHED)
        if official != self.checkpoint:
            return load_published(official).morph
        return load_run(f"{self.pair}/{self.method}", Path(self.checkpoint), self.ends).morph


def result_of_run(study: Study, job: Job, tell: Tell) -> Result:
    """Evaluate a run, unless its checkpoint was evaluated under this protocol before."""
    bare = Result(job.pair, job.method, job.seed, ends=study.ends)
    record = read_record(job.folder)
    if record is None or record.state != DONE:
        state = record.state if record else "not begun"
        retry = "; retry=true tries again" if state == FAILED else ""
        unfinished = f"it was left {state}; repeat the command to go on"
        return replace(bare, reason=record.reason + retry if record and record.reason else unfinished)
    file = job.folder / "checkpoints" / "best.ckpt"
    bare = replace(_timed(bare, job.folder), steps=record.steps, terms=_last_terms(job.folder))
    try:
        key = {"checkpoint": hashlib.sha256(file.read_bytes()).hexdigest(), "ends": study.ends}
        return _evaluated(
            bare,
            job.folder,
            key,
            lambda: load_run(job.name, file, study.ends),
            study.protocol,
            tell,
            str(file),
        )
    except (InputError, OSError, ValueError, RuntimeError) as error:  # one row must not end the study
        return replace(bare, reason=f"it could not be evaluated: {error}")


def result_of_official(study: Study, pair: Choice, tell: Tell) -> Result:
    """Evaluate the authors' morph of a pair."""
    bare = Result(pair.name, OFFICIAL, None)
    name = official_pair(pair)
    if name is None:
        return replace(bare, reason="the authors published no morph of this pair")
    folder = study.folder / "runs" / pair.name / OFFICIAL
    try:
        published = f"{PUBLISHED}{name}"
        key = {"checkpoint": published}
        return _evaluated(bare, folder, key, lambda: load_published(name), study.protocol, tell, published)
    except (InputError, OSError, ValueError, RuntimeError) as error:
        return replace(bare, reason=str(error))


def _evaluated(
    bare: Result,
    folder: Path,
    key: dict[str, Any],
    load: Callable[[], LoadedMorph],
    protocol: Protocol,
    tell: Tell,
    checkpoint: str,
) -> Result:
    """The result with its figures, from ``evaluation.json`` if that is of the same key."""
    # a version that measures more measures again
    names = hashlib.sha256("\n".join(metric.name for metric in all_metrics()).encode()).hexdigest()
    key = key | {"protocol": protocol.describe(), "version": nsm.__version__, "figures": names}
    file = folder / "evaluation.json"
    kept = json.loads(file.read_text()) if file.is_file() else {}
    if kept.get("key") != key:
        loaded = load()
        name = f"{bare.pair}/{bare.method}"
        flow_error = None if loaded.exact is None else loaded.exact.flow_error
        result = evaluate_morph(loaded.morph, protocol, lambda stage: tell(f"{name}: {stage}"), flow_error)
        network: dict[str, float | None] = {}
        if loaded.network is not None:
            without = evaluate_morph(loaded.network, protocol, lambda stage: tell(f"{name} (network): {stage}"))
            network = without.to_dict()["figures"]
        kept = {"key": key, **result.to_dict(), "network_figures": network}
        with whole_file(file) as temporary:
            temporary.write_text(json.dumps(kept, indent=2) + "\n")
    curve = kept["volume"]
    volumes = [math.nan if v is None else v for v in curve["volumes"]]
    return replace(
        bare,
        figures=kept["figures"],
        network_figures=kept["network_figures"],
        times=curve["times"],
        volumes=volumes,
        checkpoint=checkpoint,
    )


def _timed(bare: Result, folder: Path) -> Result:
    """With the times that the run noted; a method that makes no steps has only its summary."""
    summary = json.loads((folder / "summary.json").read_text())
    file = folder / "step_times.json"
    times = json.loads(file.read_text()) if file.is_file() else {}
    training = times.get("training_s", summary.get("training_s"))
    return replace(bare, training_s=training, step_s=times.get("step_s"), preparing_s=summary.get("preparing_s"))


def _last_terms(folder: Path) -> dict[str, float]:
    """Mean of the last logged values of each term of the loss."""
    log = folder / "log" / "metrics.csv"
    if not log.is_file():
        return {}
    with log.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row.get("train/loss")]
    names = [name for name in (rows[-1] if rows else {}) if name and name.startswith("train/")]
    last = {name: [float(row[name]) for row in rows[-_LAST_ROWS:] if row.get(name)] for name in names}
    return {name.removeprefix("train/"): sum(values) / len(values) for name, values in last.items() if values}


def described(results: Iterable[Result]) -> list[dict[str, Any]]:
    """Results as JSON takes them."""
    return [
        {key: value for key, value in asdict(result).items() if key not in ("times", "volumes")}
        | {"volume": {"times": result.times, "volumes": [v if math.isfinite(v) else None for v in result.volumes]}}
        for result in results
    ]
