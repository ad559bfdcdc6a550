"""What is known of one run: with which settings it was begun, how many steps it makes, and how far it is."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from nsm.cli.errors import InputError
from nsm.cli.files import whole_file
from nsm.compare.plan import Budget, Job

#: States of a run on its way.
PLANNED, MEASURING, TRAINING, DONE = "planned", "measuring", "training", "done"
#: A run that failed would fail again, and is tried again only if that is asked for; an interrupted one goes on.
FAILED, INTERRUPTED = "failed", "interrupted"


class Record(NamedTuple):
    """The content of ``run.json`` in the folder of a run.

    Attributes:
        settings: what makes it this run and no other; it goes on only under the same.
        trained: whether it makes steps at all; a method in closed form does not.
        threads: of its process; None for all cores.
        steps: how many it makes; None until they are known, which for the recipe's own number is at the end.
        step_s: seconds of one step, by which minutes became steps.
        state: how far it is.
        reason: why it failed.
    """

    settings: dict[str, Any]
    trained: bool
    threads: int | None
    steps: int | None = None
    step_s: float | None = None
    state: str = PLANNED
    reason: str | None = None


def read_record(folder: Path) -> Record | None:
    """The record of a run, or None where none was begun."""
    try:
        return Record(**json.loads((folder / "run.json").read_text()))
    except FileNotFoundError:
        return None
    except (ValueError, TypeError) as error:
        raise InputError(
            f"{folder / 'run.json'} is not what a study wrote ({error}): delete the folder to run it anew"
        ) from error


def write_record(folder: Path, record: Record) -> None:
    """Keep the record of a run."""
    with whole_file(folder / "run.json") as temporary:
        temporary.write_text(json.dumps(record._asdict(), indent=2) + "\n")


def prepare(job: Job, budget: Budget, trained: bool, threads: int | None, retry: bool) -> Record:
    """Enter a run into its folder, or find out what was made of it before.

    Args:
        job: the run.
        budget: of the study.
        trained: whether the run makes steps.
        threads: of its process.
        retry: whether a run that failed is tried once more.

    Raises:
        InputError: if the folder holds a run with other settings.
    """
    settings = {"overrides": list(job.overrides), **budget._asdict()}
    before = read_record(job.folder)
    if before is None or (before.settings != settings and not _begun(job.folder)):
        record = Record(settings, trained, threads, budget.steps if trained else None)
    elif before.settings != settings:
        raise InputError(
            f"{job.folder} was begun with {_difference(before.settings, settings)}: repeat the command it was begun "
            "with, give the study another output, or delete that folder"
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
    """The settings of a run that changed, as people type them."""
    budget = [f"{key}={before[key]} (now {now[key]})" for key in ("minutes", "steps") if before[key] != now[key]]
    old, new = before["overrides"], now["overrides"]
    gone, added = [o for o in old if o not in new], [o for o in new if o not in old]
    changed = [f"{' '.join(gone) or 'nothing'} where there is {' '.join(added) or 'nothing'} now"] * (old != new)
    return " and ".join([*budget, *changed])
