"""Tables of studies: what they show, and how they are written."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

from nsm.compare import results
from nsm.compare.goals import goals_table
from nsm.metrics.unit import COUNT
from nsm.plots.tables import Cell, Column, Table, comma_separated, latex, markdown, write_table


def outcome(pair: str, seed: int | None, scale: float, method: str = "adadiv", **more: Any) -> results.Result:
    """A result whose every figure is a multiple of its place in the list."""
    figures = {name: scale * (place + 1) for place, name in enumerate(_FIGURES)}
    return results.Result(pair, method, seed, figures=figures, **more)


_FIGURES = [
    "volume std",
    "volume max",
    *(f"{name} t={t}" for name in ("morph to shape", "shape to morph", "normal error") for t in (0, 1)),
    "most pieces",
    "fewest pieces",
    "gradient norm least",
    "gradient norm greatest",
    "roughness at 1/2",
]


def test_the_table_of_all_pairs_has_the_mean_and_the_range_of_the_seeds() -> None:
    found = [outcome("a_b", seed, scale, training_s=60.0, preparing_s=30.0) for seed, scale in enumerate((1, 2, 6))]
    table = goals_table([*found, outcome("a_b", None, 1.0, "official")], ["a_b", "c_d"], ["adadiv", "official"])
    assert list(table.rows) == ["a_b, adadiv", "a_b (official)"], "a pair without results has no row"
    assert table.cells["a_b, adadiv", "volume std"].mean == 3
    assert table.cells["a_b, adadiv", "volume std"].range == (1, 6)
    assert table.cells["a_b, adadiv", "minutes, fits included"].mean == 1.5
    assert ("a_b (official)", "minutes, fits included") not in table.cells
    assert not any("exact ends" in column.name for column in table.columns)


def test_the_table_of_all_pairs_shows_exact_ends_and_the_network_beside_each_other() -> None:
    network = outcome("a_b", 0, 100.0).figures
    rows = [outcome("a_b", 0, 1.0, network_figures=network), outcome("a_b", None, 1.0, "official")]
    table = goals_table(rows, ["a_b"], ["adadiv", "official"])
    ours = {head: cell.mean for (row, head), cell in table.cells.items() if row == "a_b, adadiv"}
    assert ours["distance, exact ends"] == 6, "the greatest of both ways and ends"
    assert ours["normals, exact ends (°)"] == 8
    assert ours["morph→shape t=0"] == 300
    assert ours["normals t=1 (°)"] == 800
    assert ours["most components"] == 9, "of the morph that a user sees"
    assert ("a_b (official)", "distance, exact ends") not in table.cells


ROWS = ["adadiv", "no_eikonal", "lost"]

EXAMPLE = Table(
    "two figures",
    [Column("volume & std"), Column("slope", 1.0), Column("pieces", None, COUNT)],
    ROWS,
    {
        ("adadiv", "volume & std"): Cell(-0.00025),
        ("no_eikonal", "volume & std"): Cell(0.5),
        ("adadiv", "slope"): Cell(0.9, 0.01, 3, (0.89, 0.91)),
        ("no_eikonal", "slope"): Cell(2.0, 0.1, 3),
        ("adadiv", "pieces"): Cell(1.0),
        ("no_eikonal", "pieces"): Cell(2.0),
        ("lost", "slope"): Cell(float("nan")),
    },
)


def test_the_best_of_each_column_is_bold_and_what_is_missing_a_dash() -> None:
    assert markdown(EXAMPLE).splitlines()[2:] == [
        "| adadiv | **-0.000250** | **0.900 ± 0.0100 (0.890–0.910)** | 1 |",
        "| no_eikonal | 0.500 | 2.00 ± 0.100 | 2 |",
        "| lost | – | – | – |",
    ]


def test_what_reads_the_same_is_best_together_and_one_row_alone_is_not_best() -> None:
    column = Column("error")
    cells = {("a", "error"): Cell(0.10001), ("b", "error"): Cell(0.10002), ("c", "error"): Cell(0.2)}
    assert Table("", [column], ["a", "b", "c"], cells).best(column) == {"a", "b"}
    assert not Table("", [column], ["a"], cells).best(column)


def test_latex_is_balanced_and_escaped() -> None:
    lines = latex(EXAMPLE).splitlines()
    assert lines.count(r"\begin{tabular}{lrrr}") == lines.count(r"\end{tabular}") == 1
    rows = [line for line in lines if line.endswith(r" \\")]
    assert len(rows) == 1 + len(ROWS)
    for row in rows:
        assert len(re.findall(r"(?<!\\)&", row)) == 3
        assert row.count("{") == row.count("}")
        assert len(re.findall(r"(?<!\\)\$", row)) % 2 == 0
        assert not re.search(r"(?<!\\)[_%#]", row)
    assert r"volume \& std" in rows[0]
    assert r"\textbf{0.900 $\pm$ 0.0100 (0.890--0.910)}" in rows[1]


def test_csv_keeps_all_digits_and_both_numbers() -> None:
    table = list(csv.DictReader(comma_separated(EXAMPLE).splitlines()))
    assert table[0]["volume & std"] == "-0.00025"
    assert (table[1]["slope"], table[1]["slope std"], table[1]["slope min"]) == ("2", "0.1", "")
    assert (table[0]["slope min"], table[0]["slope max"]) == ("0.89", "0.91")
    assert table[2]["pieces"] == ""


def test_a_table_is_written_three_times(tmp_path: Path) -> None:
    files = write_table(tmp_path / "speed_1.5", EXAMPLE)
    assert [file.name for file in files] == ["speed_1.5.md", "speed_1.5.csv", "speed_1.5.tex"]
    assert all(file.stat().st_size for file in files)
