"""Measured volumes over time beside those that the paper prints, and the order of the methods in both."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

from nsm.compare.printed import Printed, readings
from nsm.compare.results import Result
from nsm.compare.tabulate import cell, of_row
from nsm.metrics.unit import RELATIVE
from nsm.plots.tables import Cell, Column, Table

#: Figures that are compared with the paper's variance and maximum.
_STD, _MAX = "volume std", "volume max"
#: Columns of the printed figures.
_VARIANCE, _MAXIMUM = "paper's variance", "paper's maximum"


class Order(NamedTuple):
    """Order of the methods of one pair by the volume over time, best first.

    Attributes:
        pair: The pair.
        printed: Order in the paper.
        measured: Order of the means that were measured.
        reversed: Methods whose order is the opposite of the paper's, the one that the paper places first before the
            other, and whether they are further apart than one standard deviation of each over the seeds.
    """

    pair: str
    printed: tuple[str, ...]
    measured: tuple[str, ...]
    reversed: tuple[tuple[str, str, bool], ...]


def paper_table(results: Sequence[Result], printed: Printed) -> Table:
    """Tabulate standard deviation and greatest deviation of the volume beside the figures that the paper prints."""
    columns = [
        Column(_STD, None, RELATIVE),
        Column(_VARIANCE, None, RELATIVE),
        Column(_MAX, None, RELATIVE),
        Column(_MAXIMUM, None, RELATIVE),
    ]
    cells: dict[tuple[str, str], Cell] = {}
    rows = []
    for pair, methods in printed.items():
        for method, figures in methods.items():
            measured = {name: _measured(results, pair, method, name) for name in (_STD, _MAX)}
            if measured[_STD] is None:
                continue
            row = f"{pair}, {method}"
            rows.append(row)
            cells |= {(row, name): found for name, found in measured.items() if found is not None}
            cells |= {(row, _VARIANCE): Cell(figures.variance), (row, _MAXIMUM): Cell(figures.maximum)}
    return Table("Volume over time, measured and as table 9 of the paper prints it", columns, rows, cells, "pair")


def orders(results: Sequence[Result], printed: Printed) -> list[Order]:
    """Compare the order of the methods by the standard deviation of the volume with that of the paper's variance."""
    found = []
    for pair, methods in printed.items():
        known = {m: c for m in methods if (c := _measured(results, pair, m, _STD)) is not None}
        if len(known) < 2:
            continue
        ranked = sorted(known, key=lambda method: methods[method].variance)
        backwards = tuple(
            (first, second, known[second].mean + _spread(known[second]) < known[first].mean - _spread(known[first]))
            for first, second in combinations(ranked, 2)
            if known[first].mean > known[second].mean and methods[first].variance < methods[second].variance
        )
        found.append(Order(pair, tuple(ranked), tuple(sorted(known, key=lambda m: known[m].mean)), backwards))
    return found


def paper_lines(results: Sequence[Result], printed: Printed) -> list[str]:
    """Sentences below the table: what the printed figures can be, and where the order of the methods differs."""
    count = readings(printed)
    lines = [
        f"The paper's variance cannot be a variance of its maximum's values in {count.as_variance} of its "
        f"{count.entries} entries, since the square root of a variance is at most the greatest deviation; taken for a "
        f"standard deviation it contradicts the maximum in {count.as_deviation}. It is compared with the standard "
        "deviation, and the order of the methods rather than the figures.",
        "",
    ]
    for order in orders(results, printed):
        lines.append(
            f"- **{order.pair}**, best first: {', '.join(order.printed)} in the paper; {', '.join(order.measured)} "
            f"here. {_said(order)}"
        )
    return [*lines, ""]


def _said(order: Order) -> str:
    if not order.reversed:
        return "The paper's order is reproduced."
    told = [
        f"{first} before {second}" + ("" if apart else " (within the spread of the seeds)")
        for first, second, apart in order.reversed
    ]
    return f"Not reproduced: {', '.join(told)}."


def _measured(results: Sequence[Result], pair: str, method: str, name: str) -> Cell | None:
    return cell(of_row(results, pair, method), lambda result: result.figures.get(name))


def _spread(found: Cell) -> float:
    """Standard deviation over the seeds."""
    return found.std
