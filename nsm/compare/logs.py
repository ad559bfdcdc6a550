"""What the log of a run, ``log/metrics.csv``, says of its training."""

from __future__ import annotations

import csv
from pathlib import Path

from nsm.compare.choices import VALIDATED

#: Rows at the end of a log that are averaged, since a single batch is noisy.
_LAST_ROWS = 5


def last_terms(folder: Path) -> dict[str, float]:
    """Average the last logged values of each term of the loss."""
    rows = [row for row in _rows(folder) if row.get("train/loss")]
    names = [name for name in (rows[-1] if rows else {}) if name and name.startswith("train/")]
    last = {name: [float(row[name]) for row in rows[-_LAST_ROWS:] if row.get(name)] for name in names}
    return {name.removeprefix("train/"): sum(values) / len(values) for name, values in last.items() if values}


def read_course(folder: Path) -> list[dict[str, float]]:
    """Read the validations of a run: the number of steps before each, and its figures by name."""
    rows = [row for row in _rows(folder) if all(row.get(name) for name in VALIDATED)]
    # Lightning counts steps from 0
    return [{"step": float(row["step"]) + 1, **{name: float(row[name]) for name in VALIDATED}} for row in rows]


def _rows(folder: Path) -> list[dict[str, str]]:
    log = folder / "log" / "metrics.csv"
    if not log.is_file():
        return []
    with log.open(newline="") as file:
        return list(csv.DictReader(file))
