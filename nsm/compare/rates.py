"""Learning rates of the methods of a study: each gets its own best among the same few, by its validation error."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

from nsm.compare.choices import ERROR
from nsm.compare.plan import Job, Rates
from nsm.compare.record import has_ended
from nsm.plots.tables import Cell, Column, Table


def finished(tries: Sequence[Job]) -> bool:
    """Whether every trial has ended, so that rates can be chosen."""
    return all(has_ended(job.folder) for job in tries)


def best_rates(tries: Sequence[Job]) -> Rates:
    """Learning rate with the least validation error of each method on each pair; a run that failed has an infinite one.

    Args:
        tries: Finished trials.
    """
    best: dict[tuple[str, str], tuple[float, float]] = {}
    for job in tries:
        assert job.rate is not None
        found = (error_of(job), job.rate)
        best[job.pair, job.method] = min(best.get((job.pair, job.method), found), found)
    return {choice: rate for choice, (_, rate) in best.items()}


def error_of(job: Job) -> float:
    """Validation error of the best checkpoint of a run; infinite without one."""
    file = job.folder / "summary.json"
    error = json.loads(file.read_text()).get(ERROR) if file.is_file() else None
    return math.inf if error is None or not math.isfinite(error) else float(error)


def rates_table(pair: str, tries: Sequence[Job], methods: Sequence[str]) -> Table:
    """Tabulate the validation error of each method of one pair at each learning rate."""
    ours = [job for job in tries if job.pair == pair and job.rate is not None]
    names = {job.rate: f"{job.rate:g}" for job in ours}
    cells = {(job.method, names[job.rate]): Cell(error_of(job)) for job in ours if math.isfinite(error_of(job))}
    shown = [method for method in methods if any(job.method == method for job in ours)]
    columns = [Column(name, None) for name in names.values()]
    return Table(f"{pair}: validation error by learning rate, first seed", columns, shown, cells)
