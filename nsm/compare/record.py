"""Record of one run of a study: its settings, its number of steps, and its state."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from filelock import FileLock

from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.compare.plan import Budget, Job

#: States of a run before and during training, and after it.
PLANNED, TIMING, TRAINING, DONE = "planned", "timing", "training", "done"
#: States of a run that ended early. One that failed would fail again, so it is tried again on request only; one that
#: was interrupted resumes.
FAILED, INTERRUPTED = "failed", "interrupted"


class Record(NamedTuple):
    """Content of ``run.json`` in the folder of a run.

    Attributes:
        settings: Overrides and budget; a run resumes only with the same settings.
        trained: Whether it is trained in steps; a method in closed form is not.
        threads: Threads of its process; None for all cores.
        steps: Number of steps; None until it is known, which for the recipe's own number is at the end.
        step_s: Measured seconds per step, by which minutes are converted to steps.
        state: State.
        reason: Reason of a failure or an interruption.
    """

    settings: dict[str, Any]
    trained: bool
    threads: int | None
    steps: int | None = None
    step_s: float | None = None
    state: str = PLANNED
    reason: str | None = None


def being_carried_out(folder: Path) -> FileLock:
    """The lock that a worker holds while it trains or measures in a folder; it ends with the worker in any case."""
    return FileLock(folder / ".nsm-worker.lock")


def read_record(folder: Path) -> Record | None:
    """Read the record of a run; None where none was begun.

    Raises:
        InputError: If the file is not such a record.
    """
    try:
        return Record(**json.loads((folder / "run.json").read_text()))
    except FileNotFoundError:
        return None
    except (ValueError, TypeError) as error:
        raise InputError(
            f"`{folder / 'run.json'}` must be the record of a run, got a file that is not ({error}). "
            f"Try `rm -r {folder}` to run it anew."
        ) from error


def has_ended(folder: Path) -> bool:
    """Whether a run is done, or failed."""
    record = read_record(folder)
    return record is not None and record.state in (DONE, FAILED)


def write_record(folder: Path, record: Record) -> None:
    """Write the record of a run."""
    with atomic_write(folder / "run.json") as temporary:
        temporary.write_text(json.dumps(record._asdict(), indent=2) + "\n")


def prepare(job: Job, budget: Budget, trained: bool, threads: int | None, retry: bool) -> Record:
    """Plan a run in its folder, or find its record there.

    Args:
        job: The run.
        budget: Budget of the study.
        trained: Whether the run is trained in steps.
        threads: Threads of its process.
        retry: Whether a run that failed is tried again.

    Returns:
        The record.

    Raises:
        InputError: If the folder holds a run with other settings.
    """
    settings = {"overrides": list(job.overrides), **budget._asdict()}
    before = read_record(job.folder)
    if before is None or (before.settings != settings and not _begun(job.folder)):
        record = Record(settings, trained, threads, budget.steps if trained else None)
    elif before.settings != settings:
        raise InputError(
            f"`output` must be a folder without runs of other settings, got {job.folder}, begun with "
            f"{_difference(before.settings, settings)}. Try `output=outputs/studies/other`."
        )
    else:
        kept = before.state in (DONE, FAILED) and not (retry and before.state == FAILED)
        record = before if kept else before._replace(state=PLANNED, reason=None, threads=threads)
    if record != before:
        write_record(job.folder, record)
    return record


def _begun(folder: Path) -> bool:
    return (folder / "checkpoints").is_dir() or (folder / "summary.json").is_file()


def _difference(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Describe the settings of a run that changed, in the syntax of overrides."""
    budget = [f"{key}={before[key]} (now {now[key]})" for key in ("minutes", "steps") if before[key] != now[key]]
    old, new = before["overrides"], now["overrides"]
    gone, added = [o for o in old if o not in new], [o for o in new if o not in old]
    changed = [f"{' '.join(gone) or 'nothing'} (now {' '.join(added) or 'nothing'})"] if old != new else []
    return " and ".join([*budget, *changed])
