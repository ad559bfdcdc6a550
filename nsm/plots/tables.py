"""Tables that compare: Markdown for reading, CSV for computing, LaTeX for papers; what is best is in bold."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from nsm.cli.files import whole_file


class Cell(NamedTuple):
    """A figure, as the mean and the standard deviation of what several seeds gave (0 for a single one), and its range.

    The range is the least and the greatest of them, None where it is not to be shown.
    """

    mean: float
    std: float = 0.0
    seeds: int = 1
    range: tuple[float, float] | None = None


class Column(NamedTuple):
    """A column of a table.

    Attributes:
        name: its heading.
        distance: of a figure from what it should be, of which the least is best; None where none is better.
        digits: after the point; None for three significant ones.
    """

    name: str
    distance: Callable[[float], float] | None = abs
    digits: int | None = None


def from_one(value: float) -> float:
    """How far a figure is from 1."""
    return abs(value - 1)


class Table(NamedTuple):
    """Figures by row and column; a figure that is not there has no cell.

    Attributes:
        title: what it shows.
        columns: in order.
        rows: names of the rows, in order.
        cells: by (row, name of column).
        corner: the heading of the names of the rows.
    """

    title: str
    columns: Sequence[Column]
    rows: Sequence[str]
    cells: Mapping[tuple[str, str], Cell]
    corner: str = "method"

    def best(self, column: Column) -> set[str]:
        """The rows that nothing in a column beats; those that read the same share the place."""
        if column.distance is None:
            return set()
        known = {row: cell for row in self.rows if (cell := self.cells.get((row, column.name))) is not None}
        ranks = {row: column.distance(cell.mean) for row, cell in known.items() if math.isfinite(cell.mean)}
        if len(ranks) < 2:
            return set()
        first = min(ranks, key=lambda row: ranks[row])
        shown = _shown(known[first].mean, column.digits)
        return {row for row in ranks if ranks[row] == ranks[first] or _shown(known[row].mean, column.digits) == shown}


def markdown(table: Table) -> str:
    """The table in Markdown."""
    lines = [[table.corner, *(c.name for c in table.columns)], ["---", *["---:"] * len(table.columns)]]
    lines += [[row, *texts] for row, texts in _texts(table, " ± ", lambda text: f"**{text}**")]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def latex(table: Table) -> str:
    """The table in LaTeX, for the packages booktabs and a caption of one's own."""
    head = " & ".join(_escaped(name) for name in (table.corner, *(c.name for c in table.columns)))
    body = [
        " & ".join([_escaped(row), *texts]).replace(_MISSING, "--") + r" \\"
        for row, texts in _texts(table, r" $\pm$ ", lambda text: rf"\textbf{{{text}}}")
    ]
    lines = [
        f"% {table.title}; needs \\usepackage{{booktabs}}",
        rf"\begin{{tabular}}{{l{'r' * len(table.columns)}}}",
        r"\toprule",
        head + r" \\",
        r"\midrule",
        *body,
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def comma_separated(table: Table) -> str:
    """The table as CSV, all digits; with several seeds, the deviation, least, and greatest value beside each mean."""
    several = any(cell.seeds > 1 for cell in table.cells.values())
    beside = ("std", "min", "max") if several else ()
    heads = [[column.name, *(f"{column.name} {what}" for what in beside)] for column in table.columns]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([table.corner, *(head for pair in heads for head in pair)])
    for row in table.rows:
        found = [table.cells.get((row, column.name)) for column in table.columns]
        writer.writerow([row, *(text for cell in found for text in _digits(cell)[: 1 + len(beside)])])
    return out.getvalue()


def write_table(stem: Path, table: Table) -> list[Path]:
    """Write a table beside ``stem`` with the suffixes .md, .csv and .tex; returns the files."""
    texts = {".md": f"{table.title}\n\n{markdown(table)}", ".csv": comma_separated(table), ".tex": latex(table)}
    files = [stem.with_name(stem.name + suffix) for suffix in texts]
    for file, text in zip(files, texts.values(), strict=True):
        with whole_file(file) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return files


def _texts(table: Table, between: str, bold: Callable[[str], str]) -> list[tuple[str, list[str]]]:
    """Rows of cells as text."""
    best = {column.name: table.best(column) for column in table.columns}
    rows = []
    for row in table.rows:
        texts = []
        for column in table.columns:
            cell = table.cells.get((row, column.name))
            if cell is None:
                texts.append(_MISSING)
                continue
            text = _shown(cell.mean, column.digits)
            if cell.seeds > 1:
                text += between + _shown(cell.std, column.digits)
                text += f" ({'–'.join(_shown(value, column.digits) for value in cell.range)})" if cell.range else ""
            texts.append(bold(text) if row in best[column.name] else text)
        rows.append((row, texts))
    return rows


def _digits(cell: Cell | None) -> list[str]:
    """Mean, deviation, least and greatest value, all digits; nothing where there is none."""
    if cell is None:
        return [""] * 4
    known = [f"{value:.9g}" for value in (cell.mean, cell.std, *(cell.range or ()))]
    return known + [""] * (4 - len(known))


def _shown(value: float, digits: int | None) -> str:
    if not math.isfinite(value):
        return _MISSING
    if digits is not None:
        return f"{value:.{digits}f}"
    if value == 0 or 1e-4 <= abs(value) < 1e4:
        return f"{value:#.3g}".rstrip(".")
    return f"{value:.1e}"


#: In place of a figure that is not there.
_MISSING = "–"
#: What LaTeX reads as something else, or does not know.
_LATEX = {
    "\\": r"\textbackslash{}",
    **{sign: "\\" + sign for sign in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "|": r"\textbar{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "‖": r"$\|$",
    "∇": r"$\nabla$",
    "°": r"$^\circ$",
}


def _escaped(text: str) -> str:
    return "".join(_LATEX.get(sign, sign) for sign in text)
