"""Losses and figures of validation as a table."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from lightning.fabric.loggers.logger import rank_zero_experiment
from lightning.pytorch.loggers import CSVLogger
from lightning.pytorch.utilities.rank_zero import rank_zero_only


class CsvLog(CSVLogger):
    """Writes Lightning's ``metrics.csv``, and continues it when training resumes after a stop or a collapse.

    Rows of repeated steps are replaced. Lightning's own logger deletes the file.
    """

    _before: list[dict[str, Any]] = []  # noqa: RUF012 (never changed in place)

    @property
    @rank_zero_experiment
    def experiment(self) -> Any:
        """Writer of the file."""
        if self._experiment is None:
            file = Path(self.log_dir) / "metrics.csv"
            if file.is_file():
                with file.open(newline="") as rows:
                    self._before = list(csv.DictReader(rows))
        return super().experiment

    @rank_zero_only
    def log_metrics(self, metrics: Any, step: int | None = None) -> None:
        """Add a row, after those of earlier steps if it is the first."""
        if step is not None:
            self._keep_before(step)
        super().log_metrics(metrics, step)

    @rank_zero_only
    def finalize(self, status: str) -> None:
        """Write all remaining rows, even if nothing was logged."""
        self._keep_before(None)
        super().finalize(status)

    def _keep_before(self, step: int | None) -> None:
        writer, before = self.experiment, self._before
        if before:
            self._before = []
            writer.metrics.extend(row for row in before if step is None or int(row["step"]) < step)
            self.save()
