"""Table of all pairs of a study with the figures that a user cares about most."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

from nsm.compare.choices import OFFICIAL
from nsm.compare.results import Result
from nsm.compare.tabulate import cell, of_row
from nsm.metrics import find_metric
from nsm.metrics.unit import Unit
from nsm.plots.tables import Column, Table

#: Figures by name.
Figures = Mapping[str, float | None]


class _Goal(NamedTuple):
    """A column.

    Attributes:
        heading: Heading of the column.
        figures: Figures of which it shows the greatest.
    """

    heading: str
    figures: tuple[str, ...]

    @property
    def unit(self) -> Unit:
        """Unit of the figures."""
        return find_metric(self.figures[0]).unit


_VOLUME = (_Goal("volume std", ("volume std",)), _Goal("volume max", ("volume max",)))
_WAYS = ("morph to shape", "shape to morph")
#: Columns of the morph with exact ends.
_EXACT = (
    _Goal("distance, exact ends", tuple(f"{way} t={t}" for way in _WAYS for t in (0, 1))),
    _Goal("normals, exact ends (°)", ("normal error t=0", "normal error t=1")),
)
#: Columns of the network alone.
_NETWORK = (
    *(_Goal(f"{way.replace(' to ', '→')} t={t}", (f"{way} t={t}",)) for way in _WAYS for t in (0, 1)),
    _Goal("normals t=0 (°)", ("normal error t=0",)),
    _Goal("normals t=1 (°)", ("normal error t=1",)),
)
_SURFACE = (
    _Goal("most components", ("most pieces",)),
    _Goal("fewest", ("fewest pieces",)),
    _Goal("‖∇f‖ least", ("gradient norm least",)),
    _Goal("‖∇f‖ greatest", ("gradient norm greatest",)),
    _Goal("dihedral ½ / ends", ("roughness at 1/2",)),
)
#: Column of the time that a run takes, and its unit.
_MINUTES, _MINUTE = "minutes, fits included", Unit("minute", decimals=1)


def goals_table(results: Sequence[Result], pairs: Sequence[str], methods: Sequence[str]) -> Table:
    """Tabulate the main figures of all pairs, a row per pair and method, a column per figure.

    Volume and surface are those of the morph as a user sees it. Distances and normals of a morph with exact ends appear
    twice: with exact ends, and of the network alone. A morph without exact ends has only the latter.

    Args:
        results: Results of the study.
        pairs: Pairs, in order.
        methods: Methods, in order.
    """
    exact = any(result.network_figures for result in results)
    units: dict[str, Unit] = {}
    takes: dict[str, Callable[[Result], float | None]] = {}
    for goals, source in (
        (_VOLUME, _seen),
        (_EXACT if exact else (), _with_exact_ends),
        (_NETWORK, _of_network),
        (_SURFACE, _seen),
    ):
        units |= {goal.heading: goal.unit for goal in goals}
        takes |= {goal.heading: partial(_greatest, source=source, names=goal.figures) for goal in goals}
    units[_MINUTES], takes[_MINUTES] = _MINUTE, _minutes
    named = {_row(pair, method): (pair, method) for pair in pairs for method in methods}
    cells = {
        (row, heading): found
        for row, (pair, method) in named.items()
        for heading, take in takes.items()
        if (found := cell(of_row(results, pair, method), take)) is not None
    }
    # no value is marked as best, since rows are of different pairs
    columns = [Column(heading, None, unit) for heading, unit in units.items()]
    shown = {row for row, _ in cells}
    return Table(_title(exact), columns, [row for row in named if row in shown], cells, "pair")


def _title(exact: bool) -> str:
    whose = (
        "distances and normals with exact ends, then of the network alone"
        if exact
        else "distances and normals of the network"
    )
    return (
        f"Volume over time, {whose}, components above 1e-5 of the volume, ‖∇f‖ on the moving surface at its least and "
        "greatest time, and the dihedral angle at t = ½ over the greater one of the two ends"
    )


def _row(pair: str, method: str) -> str:
    return f"{pair} ({method})" if method == OFFICIAL else f"{pair}, {method}"


def _seen(result: Result) -> Figures:
    return result.figures


def _with_exact_ends(result: Result) -> Figures:
    return result.figures if result.network_figures else {}


def _of_network(result: Result) -> Figures:
    return result.network_figures or result.figures


def _greatest(result: Result, source: Callable[[Result], Figures], names: Sequence[str]) -> float | None:
    known = [value for name in names if (value := source(result).get(name)) is not None]
    return max(known) if len(known) == len(names) else None


def _minutes(result: Result) -> float | None:
    if result.training_s is None:
        return None
    return (result.training_s + (result.preparing_s or 0.0)) / 60
