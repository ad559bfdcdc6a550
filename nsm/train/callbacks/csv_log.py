"""Losses and figures of validation as a table."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightning.fabric.loggers.logger import rank_zero_experiment
from lightning.pytorch.loggers import CSVLogger
from lightning.pytorch.utilities.rank_zero import rank_zero_only
from torch import Tensor

from nsm.cli.files import atomic_write


class CsvLog(CSVLogger):
    """Writes ``metrics.csv``, and continues it when training resumes after a stop or a collapse.

    Rows of repeated steps are replaced, and rows that a kill has cut are dropped. The file is replaced as a whole;
    Lightning's own logger deletes it at the start.
    """

    @property
    @rank_zero_experiment
    def experiment(self) -> Any:
        """Rows of the file."""
        if self._experiment is None:
            self._experiment = _Rows(Path(self.log_dir) / "metrics.csv")  # type: ignore[assignment]
        return self._experiment

    @rank_zero_only
    def save(self) -> None:
        """Write the file."""
        self.experiment.save()


class _Rows:
    """Rows of a table, those of an earlier session first.

    Args:
        file: File of the table.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self.metrics = _read(file)
        self._resumed = bool(self.metrics)

    def log_metrics(self, metrics: Mapping[str, Any], step: int) -> None:
        """Add a row; the first one of a session replaces all rows from its step on."""
        if self._resumed:
            self.metrics = [row for row in self.metrics if int(row["step"]) < step]
            self._resumed = False
        values = {name: value.item() if isinstance(value, Tensor) else value for name, value in metrics.items()}
        self.metrics.append({**values, "step": step})

    def save(self) -> None:
        """Write all rows."""
        if not self.metrics:
            return
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, sorted(set().union(*self.metrics)))
        writer.writeheader()
        writer.writerows(self.metrics)
        with atomic_write(self.file) as temporary:
            temporary.write_text(text.getvalue(), newline="")


def _read(file: Path) -> list[dict[str, Any]]:
    """Read the complete rows of a table; the last line of a file that was cut has no end."""
    if not file.is_file():
        return []
    text = file.read_bytes().decode(errors="replace").replace("\0", "")
    lines = [line for line in text.splitlines(keepends=True) if line.endswith("\n")]
    rows = csv.DictReader(lines)
    return [row for row in rows if None not in row and None not in row.values() and (row.get("step") or "").isdigit()]
