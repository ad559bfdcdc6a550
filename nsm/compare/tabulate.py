"""Results of a study as tables: one figure for all pairs, or the main figures of one pair."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

from nsm.compare.results import Result
from nsm.metrics import Metric, all_metrics, find_metric
from nsm.metrics.unit import COUNT
from nsm.plots.tables import Cell, Column, Table

#: Conversion of seconds to minutes and to milliseconds.
_MINUTES, _MILLISECONDS = 1 / 60, 1000.0


def figure_names(results: Iterable[Result]) -> list[str]:
    """Names of all figures that some result has, in order."""
    return list(dict.fromkeys(name for result in results for name in result.figures))


def figure_table(name: str, results: Sequence[Result], pairs: Sequence[str], rows: Sequence[str]) -> Table:
    """Tabulate one figure, a row per method and a column per pair.

    For ``volume std`` this is table 9 of the paper.

    Args:
        name: Name of the figure.
        results: Results of the study.
        pairs: Pairs, in order.
        rows: Methods, in order.
    """
    metric = find_metric(name)
    title = f"{name} ({metric.unit.name}): {metric.meaning}"
    columns = [Column.of(metric, pair) for pair in pairs]
    cells = {}
    for pair in pairs:
        for row in rows:
            found = cell(of_row(results, pair, row), partial(_figure, name=name))
            if found is not None:
                cells[row, pair] = found
    return Table(title, columns, rows, cells)


def overview(pair: str, results: Sequence[Result], rows: Sequence[str]) -> Table:
    """Tabulate the main figures of one pair, those with a heading, a row per method."""
    known = {name for result in results if result.pair == pair for name in result.figures}
    main = {
        _heading(metric, name): (metric, name)
        for metric in all_metrics()
        for name in metric.rows(known)
        if metric.heading is not None
    }
    takes: dict[str, Callable[[Result], float | None]] = {
        heading: partial(_figure, name=name) for heading, (_, name) in main.items()
    }
    columns = [Column.of(metric, heading) for heading, (metric, _) in main.items()]
    return by_column(pair, results, rows, columns, takes)


def _heading(metric: Metric, name: str) -> str:
    """Heading of a figure in an overview, with the time at which it was taken and the symbol of its unit."""
    symbol = f" ({metric.unit.symbol})" if metric.unit.symbol else ""
    return f"{metric.heading}{name.removeprefix(metric.name)}{symbol}"


def times_table(pair: str, results: Sequence[Result], rows: Sequence[str]) -> Table:
    """Tabulate the times of training and of one step for one pair (figure 12 of the paper), and the learning rate."""
    columns = [
        Column("training (min)", None),
        Column("step (ms)"),
        Column("steps", None, COUNT),
        Column("preparation (s)", None),
        Column("learning rate", None),
    ]
    takes: dict[str, Callable[[Result], float | None]] = {
        "training (min)": lambda result: _scaled(result.training_s, _MINUTES),
        "step (ms)": lambda result: _scaled(result.step_s, _MILLISECONDS),
        "steps": lambda result: result.steps,
        "preparation (s)": lambda result: result.preparing_s,
        "learning rate": lambda result: result.rate,
    }
    columns = [column for column in columns if any(takes[column.name](result) is not None for result in results)]
    return by_column(f"{pair}: times", results, rows, columns, takes)


def terms_table(pair: str, results: Sequence[Result], rows: Sequence[str]) -> Table:
    """Tabulate the weighted terms of the loss at the end of training for one pair."""
    names = list(dict.fromkeys(name for result in results if result.pair == pair for name in result.terms))
    takes: dict[str, Callable[[Result], float | None]] = {name: partial(_term, name=name) for name in names}
    columns = [Column(name, None) for name in names]
    return by_column(f"{pair}: weighted terms of the loss at the end", results, rows, columns, takes)


def by_column(
    title: str,
    results: Sequence[Result],
    rows: Sequence[str],
    columns: Sequence[Column],
    takes: Mapping[str, Callable[[Result], float | None]],
) -> Table:
    """Tabulate the results of one pair, a row per method.

    Args:
        title: Title, which begins with the pair and a colon.
        results: Results of the study.
        rows: Methods, in order.
        columns: Columns.
        takes: Takes the value of a column, by its name, from a result.
    """
    pair = title.partition(":")[0]
    cells = {}
    for column in columns:
        for row in rows:
            found = cell(of_row(results, pair, row), takes[column.name])
            if found is not None:
                cells[row, column.name] = found
    return Table(title, columns, [row for row in rows if of_row(results, pair, row)], cells)


def of_row(results: Sequence[Result], pair: str, method: str) -> list[Result]:
    """Results of a method on a pair, one per seed."""
    return [r for r in results if r.pair == pair and r.method == method]


def cell(results: Sequence[Result], take: Callable[[Result], float | None]) -> Cell | None:
    """Aggregate a figure over the seeds that have it; None where none has.

    Args:
        results: Results of one method on one pair.
        take: Takes the figure from a result.
    """
    known = [value for result in results if (value := take(result)) is not None and math.isfinite(value)]
    if not known:
        return None
    std = statistics.stdev(known) if len(known) > 1 else 0.0
    return Cell(statistics.fmean(known), std, len(known), (min(known), max(known)))


def _figure(result: Result, name: str) -> float | None:
    return result.figures.get(name)


def _term(result: Result, name: str) -> float | None:
    return result.terms.get(name)


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor
