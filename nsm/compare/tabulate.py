"""Results of a study as tables: a figure over all pairs, or a pair with its main figures."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from functools import partial

from nsm.compare.results import Result
from nsm.metrics.figures import AT, meaning
from nsm.plots.tables import Cell, Column, Table, from_one

#: Figures of an overview, and what stands above their columns.
_MAIN = {
    "volume std": "volume std",
    "volume max": "volume max",
    "chamfer t=0": "distance t=0",
    "chamfer t=1": "distance t=1",
    "normal error t=0": "normals t=0 (°)",
    "normal error t=1": "normals t=1 (°)",
    "gradient norm mean": "‖∇f‖",
    "level set surface": "level set error",
    "roughness mean": "roughness (°)",
    "most pieces": "components",
    "topology events": "changes of topology",
}
#: Figures that are better the nearer they are to one.
_NEAR_ONE = ("gradient norm mean", "gradient norm least", "gradient norm greatest", "speed max/mean")
#: Figures of which neither the greatest nor the least is better.
_NEUTRAL = (
    f"volume{AT}0",
    f"volume{AT}1",
    "volume estimator error",
    "distance moved",
    "motion in middle half",
    "area least",
    "area greatest",
    "fewest components",
    "most components",
    "fewest pieces",
    "most pieces",
    "most handles",
    "topology events",
)
#: Places after the point of figures that are counted, and of angles.
_DIGITS = {"count": 0, "degree": 1}
#: Of minutes and of milliseconds.
_MINUTES, _MILLISECONDS = 1 / 60, 1000.0


def figure_names(results: Iterable[Result]) -> list[str]:
    """All figures that some result has, in order."""
    return list(dict.fromkeys(name for result in results for name in result.figures))


def figure_table(name: str, results: Sequence[Result], pairs: Sequence[str], rows: Sequence[str]) -> Table:
    """One figure: a row a method, a column a pair (table 9 of the paper for ``volume std`` and ``volume max``)."""
    what = meaning(name)
    title = f"{name}: {what.text}" + (f" ({what.unit})" if what.unit else "")
    columns = [_column(pair, name) for pair in pairs]
    cells = {}
    for pair in pairs:
        for row in rows:
            found = cell(of_row(results, pair, row), partial(_figure, name=name))
            if found is not None:
                cells[row, pair] = found
    return Table(title, columns, rows, cells)


def overview(pair: str, results: Sequence[Result], rows: Sequence[str]) -> Table:
    """The main figures of one pair: a row a method."""
    figures = {name: head for name, head in _MAIN.items() if any(name in r.figures for r in results if r.pair == pair)}
    takes: dict[str, Callable[[Result], float | None]] = {
        head: partial(_figure, name=name) for name, head in figures.items()
    }
    return _by_column(pair, results, rows, [_column(head, name) for name, head in figures.items()], takes)


def times_table(pair: str, results: Sequence[Result], rows: Sequence[str]) -> Table:
    """Training times and step times of one pair (figure 12 of the paper)."""
    columns = [
        Column("training (min)", None),
        Column("step (ms)"),
        Column("steps", None, 0),
        Column("preparation (s)", None),
    ]
    takes: dict[str, Callable[[Result], float | None]] = {
        "training (min)": lambda result: _scaled(result.training_s, _MINUTES),
        "step (ms)": lambda result: _scaled(result.step_s, _MILLISECONDS),
        "steps": lambda result: result.steps,
        "preparation (s)": lambda result: result.preparing_s,
    }
    return _by_column(f"{pair}: times", results, rows, columns, takes)


def terms_table(pair: str, results: Sequence[Result], rows: Sequence[str]) -> Table:
    """The weighted terms of the loss at the end of training, for one pair."""
    names = list(dict.fromkeys(name for result in results if result.pair == pair for name in result.terms))
    takes: dict[str, Callable[[Result], float | None]] = {name: partial(_term, name=name) for name in names}
    columns = [Column(name, None) for name in names]
    return _by_column(f"{pair}: weighted terms of the loss at the end", results, rows, columns, takes)


def _by_column(
    title: str,
    results: Sequence[Result],
    rows: Sequence[str],
    columns: Sequence[Column],
    takes: dict[str, Callable[[Result], float | None]],
) -> Table:
    pair = title.partition(":")[0]
    cells = {}
    for column in columns:
        for row in rows:
            found = cell(of_row(results, pair, row), takes[column.name])
            if found is not None:
                cells[row, column.name] = found
    return Table(title, columns, [row for row in rows if of_row(results, pair, row)], cells)


def of_row(results: Sequence[Result], pair: str, method: str) -> list[Result]:
    """The results of a method on a pair, one a seed."""
    return [r for r in results if r.pair == pair and r.method == method]


def cell(results: Sequence[Result], take: Callable[[Result], float | None]) -> Cell | None:
    """Mean, standard deviation and range over the seeds that have a figure."""
    known = [value for result in results if (value := take(result)) is not None and math.isfinite(value)]
    if not known:
        return None
    std = statistics.stdev(known) if len(known) > 1 else 0.0
    return Cell(statistics.fmean(known), std, len(known), (min(known), max(known)))


def _column(head: str, figure: str) -> Column:
    plain = figure.split(AT)[0]
    distance = None if plain in _NEUTRAL else from_one if plain in _NEAR_ONE else abs
    unit = meaning(figure).unit
    return Column(head, distance, _DIGITS.get(unit))


def _figure(result: Result, name: str) -> float | None:
    return result.figures.get(name)


def _term(result: Result, name: str) -> float | None:
    return result.terms.get(name)


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor
