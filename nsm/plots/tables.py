"""Tables in Markdown, CSV, and LaTeX, with the best value of each column in bold."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from nsm.cli.files import atomic_write
from nsm.metrics.metric import Metric
from nsm.metrics.unit import MISSING, NUMBER, Unit


class Cell(NamedTuple):
    """A value of a table, aggregated over seeds.

    Attributes:
        mean: Mean over the seeds.
        std: Standard deviation over the seeds, 0 for a single one.
        seeds: Number of seeds.
        range: Least and greatest value; None to leave it out.
    """

    mean: float
    std: float = 0.0
    seeds: int = 1
    range: tuple[float, float] | None = None


class Column(NamedTuple):
    """A column of a table.

    Attributes:
        name: Heading.
        ideal: Value of which the nearest is best; None where no value is better than another.
        unit: Unit of the values, which sets the digits that are shown.
    """

    name: str
    ideal: float | None = 0.0
    unit: Unit = NUMBER

    @classmethod
    def of(cls, metric: Metric, name: str | None = None) -> Column:
        """Make the column of a metric, under its own name unless another is given."""
        return cls(metric.name if name is None else name, metric.ideal, metric.unit)


class Table(NamedTuple):
    """Values by row and column; a value that is not known has no cell.

    Attributes:
        title: Description of what the table shows.
        columns: Columns, in order.
        rows: Names of the rows, in order.
        cells: Values by (row, name of column).
        corner: Heading of the names of the rows.
    """

    title: str
    columns: Sequence[Column]
    rows: Sequence[str]
    cells: Mapping[tuple[str, str], Cell]
    corner: str = "method"

    def best(self, column: Column) -> set[str]:
        """Rows whose value in a column is nearest to the ideal; rows that read the same share the place."""
        ideal = column.ideal
        if ideal is None:
            return set()
        known = {row: cell.mean for row in self.rows if (cell := self.cells.get((row, column.name))) is not None}
        known = {row: mean for row, mean in known.items() if math.isfinite(mean)}
        if len(known) < 2:
            return set()
        nearest = min(known.values(), key=lambda mean: abs(mean - ideal))
        shown = column.unit.format(nearest)
        return {
            row
            for row, mean in known.items()
            if abs(mean - ideal) == abs(nearest - ideal) or column.unit.format(mean) == shown
        }


def markdown(table: Table) -> str:
    """Write a table in Markdown.

    >>> table = Table("", [Column("volume std")], ["ours", "theirs"],
    ...               {("ours", "volume std"): Cell(0.001), ("theirs", "volume std"): Cell(0.01)})
    >>> print(markdown(table), end="")
    | method | volume std |
    | --- | ---: |
    | ours | **0.00100** |
    | theirs | 0.0100 |
    """
    head = [table.corner, *(column.name for column in table.columns)]
    return markdown_lines(head, [[row, *texts] for row, texts in _texts(table, " ± ", lambda text: f"**{text}**")])


def markdown_lines(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Write rows of texts as a Markdown table whose first column is left-aligned and the others right-aligned.

    Args:
        head: Headings of the columns, k of them.
        rows: Rows of k texts.
    """
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "".join(f"| {' | '.join(text.replace('|', _PIPE) for text in line)} |\n" for line in lines)


def latex(table: Table) -> str:
    """Write a table in LaTeX, as a ``tabular`` without a caption that needs the package booktabs."""
    head = " & ".join(_escaped(name) for name in (table.corner, *(c.name for c in table.columns)))
    body = [
        " & ".join([_escaped(row), *texts]).replace(MISSING, "--") + r" \\"
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
    """Write a table as CSV with nine digits; with several seeds, std, min, and max stand beside each mean."""
    several = any(cell.seeds > 1 for cell in table.cells.values())
    beside = ("std", "min", "max") if several else ()
    heads = [[column.name, *(f"{column.name} {name}" for name in beside)] for column in table.columns]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([table.corner, *(name for names in heads for name in names)])
    for row in table.rows:
        found = [table.cells.get((row, column.name)) for column in table.columns]
        writer.writerow([row, *(text for cell in found for text in _digits(cell)[: 1 + len(beside)])])
    return out.getvalue()


def write_table(stem: Path, table: Table) -> list[Path]:
    """Write a table to ``stem`` with the suffixes .md, .csv, and .tex.

    Returns:
        The files.
    """
    texts = {".md": f"{table.title}\n\n{markdown(table)}", ".csv": comma_separated(table), ".tex": latex(table)}
    files = [stem.with_name(stem.name + suffix) for suffix in texts]
    for file, text in zip(files, texts.values(), strict=True):
        with atomic_write(file) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return files


def _texts(table: Table, between: str, bold: Callable[[str], str]) -> list[tuple[str, list[str]]]:
    """Format the cells of each row."""
    best = {column.name: table.best(column) for column in table.columns}
    rows = []
    for row in table.rows:
        texts = []
        for column in table.columns:
            cell = table.cells.get((row, column.name))
            if cell is None:
                texts.append(MISSING)
                continue
            form = column.unit.format
            text = form(cell.mean)
            if cell.seeds > 1:
                text += between + form(cell.std)
                text += f" ({'–'.join(form(value) for value in cell.range)})" if cell.range else ""
            texts.append(bold(text) if row in best[column.name] else text)
        rows.append((row, texts))
    return rows


def _digits(cell: Cell | None) -> list[str]:
    """Format mean, standard deviation, least, and greatest value with nine digits; empty where unknown."""
    if cell is None:
        return [""] * 4
    known = [f"{value:.9g}" for value in (cell.mean, cell.std, *(cell.range or ()))]
    return known + [""] * (4 - len(known))


#: A pipe inside a cell of a Markdown table.
_PIPE = r"\|"
#: Characters that LaTeX interprets or does not know, and what stands for them.
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
    """Escape a text for LaTeX."""
    return "".join(_LATEX.get(sign, sign) for sign in text)
