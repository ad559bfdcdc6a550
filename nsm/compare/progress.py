"""Progress of a study, read from the folders of its runs."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path

from nsm.cli.progress import Progress
from nsm.compare.measurement import Measurement
from nsm.compare.plan import Job
from nsm.compare.record import DONE, FAILED, INTERRUPTED, TIMING, TRAINING, read_record

#: Seconds between two readings of the folders of the runs.
_INTERVAL = 1.0
#: Bytes at the end of a log that hold its last row.
_TAIL = 4096
#: Runs or morphs that are named while they are active.
_NAMED = 3
#: Largest part of a run that counts before one more is finished.
_ALMOST = 0.999


def training_progress(jobs: Sequence[Job]) -> AbstractContextManager[None]:
    """Show how many runs are finished and how far the active ones are, whichever launcher carries them out.

    Args:
        jobs: The runs.
    """
    return _watched("training", "runs", len(jobs), partial(_show_runs, jobs))


def measuring_progress(measurements: Sequence[Measurement]) -> AbstractContextManager[None]:
    """Show how many morphs are measured and at which stage the active ones are.

    Args:
        measurements: The measurements.
    """
    return _watched("measuring", "morphs", len(measurements), partial(_show_morphs, measurements))


@contextmanager
def _watched(description: str, unit: str, total: int, show: Callable[[Progress], object]) -> Iterator[None]:
    """Call ``show`` once a second until the work ends, and once more then; not at all where there is none."""
    if not total:
        yield
        return
    closing = threading.Event()
    with Progress(description, total=total, unit=unit) as progress:
        thread = threading.Thread(target=_watch, args=(show, progress, closing), daemon=True)
        thread.start()
        try:
            yield
        finally:
            closing.set()
            thread.join()


def _watch(show: Callable[[Progress], object], progress: Progress, closing: threading.Event) -> None:
    last = False
    while not last:
        last = closing.wait(_INTERVAL)
        show(progress)


def _show_morphs(measurements: Sequence[Measurement], progress: Progress) -> None:
    active = [f"{each.name}: {stage}" for each in measurements if (stage := each.stage())]
    progress.update(sum(not each.requested() for each in measurements), detail=_some(active))


def _show_runs(jobs: Sequence[Job], progress: Progress) -> None:
    finished, parts, active = 0, 0.0, []
    for job in jobs:
        record = read_record(job.folder)
        if record is None:
            continue
        if record.state in (DONE, FAILED, INTERRUPTED):
            finished += 1
        elif record.state == TIMING:
            active.append(f"{job.name}: timing a step")
        elif record.state == TRAINING:
            step = _last_step(job.folder / "log" / "metrics.csv")
            active.append(f"{job.name}: step {step} of {record.steps}" if record.steps else job.name)
            parts += step / record.steps if record.steps else 0.0
    # active runs count for the time left, but not as finished ones
    progress.update(finished + min(parts, _ALMOST), detail=_some(active))


def _some(active: Sequence[str]) -> str:
    """Name the first of the active ones, and the number of others."""
    more = f" and {len(active) - _NAMED} more" if len(active) > _NAMED else ""
    return ", ".join(active[:_NAMED]) + more


def _last_step(log: Path) -> int:
    """Read the step of the last row of a ``metrics.csv``; 0 while there is none."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - _TAIL))
            rows = file.read().decode(errors="replace").splitlines()
    except OSError:
        return 0
    cells = rows[-1].split(",") if len(rows) > 1 else []
    return int(cells[1]) + 1 if len(cells) > 1 and cells[1].isdigit() else 0
