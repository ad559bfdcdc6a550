"""Quality over the time of training, from the validations of each run."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from nsm.cli.files import atomic_write
from nsm.compare.choices import VALIDATED
from nsm.compare.results import Result
from nsm.compare.tabulate import by_column
from nsm.metrics.unit import LENGTH, RELATIVE, Unit
from nsm.plots.curves import COLORS, LINES
from nsm.plots.tables import Column, Table

#: Labels of the panels, one for each figure of a validation.
LABELS = ("error (length)", "distance of the ends", "volume max")
#: Parts of the steps after which a table shows the validation error.
PARTS = (0.2, 0.5, 1.0)


class Moment(NamedTuple):
    """Mean over the seeds at one validation.

    Attributes:
        minutes: Minutes of training.
        mean: Mean of the figure.
        low: Least value over the seeds.
        high: Greatest value over the seeds.
    """

    minutes: float
    mean: float
    low: float
    high: float


def averaged(results: Sequence[Result], figure: str) -> list[Moment]:
    """Average one figure over the runs of a method, validation by validation.

    Args:
        results: Results of one method on one pair.
        figure: Name of the figure in the log, such as ``val/error``.
    """
    runs = [[(_minutes(result, row), row[figure]) for row in result.course if figure in row] for result in results]
    runs = [run for run in runs if run]
    # runs of one budget in minutes differ in their steps, but not in the number of validations
    return [
        Moment(
            statistics.fmean(minutes for minutes, _ in found),
            statistics.fmean(value for _, value in found),
            min(value for _, value in found),
            max(value for _, value in found),
        )
        for found in zip(*runs, strict=False)
    ]


def plot_courses(path: Path, results: Sequence[Result], methods: Sequence[str]) -> bool:
    """Draw quality over minutes of training, one line per method and a band over its seeds; False without any.

    Args:
        path: Picture to write.
        results: Results of one pair.
        methods: Methods, in order.
    """
    by_method = {name: [r for r in results if r.method == name and r.course] for name in methods}
    by_method = {name: runs for name, runs in by_method.items() if runs}
    if not by_method:
        return False
    rows = -(-len(by_method) // 4)
    figure = Figure(figsize=(2.9 * len(LABELS), 2.3 + 0.17 * rows), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(1, len(LABELS))
    for axes, label, name in zip(grid, LABELS, VALIDATED, strict=True):
        for number, (method, runs) in enumerate(by_method.items()):
            again, color = divmod(number, len(COLORS))
            course = averaged(runs, name)
            minutes = [moment.minutes for moment in course]
            axes.plot(
                minutes, [moment.mean for moment in course], LINES[again % len(LINES)], color=COLORS[color],
                label=method, linewidth=1.3, marker="o", markersize=2.5,
            )  # fmt: skip
            low, high = [moment.low for moment in course], [moment.high for moment in course]
            axes.fill_between(minutes, low, high, color=COLORS[color], alpha=0.15, linewidth=0)
        axes.set_yscale("log")
        axes.set_xlabel("minutes of training", fontsize="small")
        axes.set_ylabel(label, fontsize="small")
        axes.tick_params(labelsize="x-small", which="both")
        axes.spines[["top", "right"]].set_visible(False)
    handles, names = grid[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=4, frameon=False, fontsize="x-small")
    with atomic_write(path) as temporary:
        figure.savefig(temporary)
    return True


def course_table(pair: str, results: Sequence[Result], rows: Sequence[str]) -> Table:
    """Tabulate the validation error of one pair after parts of the steps."""
    takes: dict[str, Callable[[Result], float | None]] = {
        f"error, {part:.0%} of the steps": partial(_after, part=part, figure="val/error") for part in PARTS
    }
    takes |= {f"volume max, {part:.0%}": partial(_after, part=part, figure="val/volume_max") for part in PARTS}
    units: dict[str, Unit] = {name: LENGTH if name.startswith("error") else RELATIVE for name in takes}
    columns = [Column(name, 0.0, unit) for name, unit in units.items()]
    return by_column(f"{pair}: validation over the steps of training", results, rows, columns, takes)


def _minutes(result: Result, row: dict[str, float]) -> float:
    return row["step"] * (result.step_s or 0.0) / 60


def _after(result: Result, part: float, figure: str) -> float | None:
    """Figure of the last validation within a part of the steps."""
    last = result.course[-1]["step"] if result.course else 0.0
    known = [row[figure] for row in result.course if row["step"] <= part * last + 1e-6]
    return known[-1] if known else None
