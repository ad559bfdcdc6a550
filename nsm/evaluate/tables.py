"""Tables of all figures of some morphs, one column per morph, for a terminal and in Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from rich.console import Console
from rich.table import Table

from nsm.metrics import all_metrics
from nsm.plots.tables import markdown_lines

#: Figures by morph and name; None or nan where one is not defined.
Figures = Mapping[str, Mapping[str, float | None]]
#: Characters for the names of the figures, and for the values of one morph.
_NAMES_WIDTH, _COLUMN_WIDTH = 32, 14


def print_table(figures: Figures, title: str) -> None:
    """Print a table, in several parts where the terminal is too narrow for all morphs side by side.

    Args:
        figures: Figures of each morph; a morph may lack some that others have.
        title: Heading.
    """
    console = Console()
    if not console.is_terminal:
        console = Console(width=_NAMES_WIDTH + _COLUMN_WIDTH * len(figures))
    names, side_by_side = list(figures), max(1, (console.width - _NAMES_WIDTH) // _COLUMN_WIDTH)
    for first in range(0, len(names), side_by_side):
        console.print(_terminal_table({name: figures[name] for name in names[first : first + side_by_side]}, title))


def markdown_table(figures: Figures) -> str:
    """Write a table in Markdown.

    >>> print(markdown_table({"ours": {"volume std": 0.00123}, "theirs": {"most pieces": 2.0}}), end="")
    | figure | ours | theirs |
    | --- | ---: | ---: |
    | volume std | 0.00123 |  |
    | most pieces |  | 2 |
    """
    return markdown_lines(["figure", *figures], [row for section in _sections(figures) for row in section])


def _terminal_table(figures: Figures, title: str) -> Table:
    table = Table(title=title)
    table.add_column("figure", no_wrap=True)
    for name in figures:
        table.add_column(name, justify="right", overflow="fold")
    for section in _sections(figures):
        for row in section:
            table.add_row(*row)
        table.add_section()
    return table


def _sections(figures: Figures) -> Iterator[list[list[str]]]:
    """Rows of texts, by section of the table; a row that no morph has is left out."""
    rows: dict[str, list[list[str]]] = {}
    for metric in all_metrics():
        for name in metric.rows(name for of_morph in figures.values() for name in of_morph):
            values = [of_morph.get(name) for of_morph in figures.values()]
            texts = ["" if v is None or math.isnan(v) else metric.unit.format(v) + metric.unit.symbol for v in values]
            if any(texts):
                rows.setdefault(metric.section.value, []).append([name, *texts])
    yield from rows.values()
