"""A table of all runs at the end of a multirun."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from rich.console import Console
from rich.table import Table

from nsm.files import whole_file


class SweepSummary(Callback):
    """Collects the ``summary.json`` of every run below the sweep's folder into ``summary.csv``, and prints it."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Write and print the table."""
        folder = Path(config.hydra.sweep.dir)
        files = sorted((f.relative_to(folder) for f in folder.rglob("summary.json")), key=_number)
        runs = {str(f.parent): json.loads((folder / f).read_text()) for f in files}
        if not runs:
            return
        columns = list(dict.fromkeys(name for figures in runs.values() for name in figures))
        with whole_file(folder / "summary.csv") as temporary, temporary.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["run", *columns])
            writer.writerows([run, *(figures.get(name, "") for name in columns)] for run, figures in runs.items())
        table = Table(title=f"{len(runs)} runs in {folder}")
        table.add_column("run", overflow="fold")
        for name in columns:
            table.add_column(name.removeprefix("val/"), justify="right")
        for run, figures in runs.items():
            table.add_row(run, *(f"{figures[name]:.4g}" if name in figures else "" for name in columns))
        Console().print(table)


def _number(file: Path) -> tuple[int, str]:
    """Runs in the order of their job numbers, which their folders' names begin with."""
    head = file.parts[0].partition("_")[0]
    return (int(head) if head.isdigit() else 1 << 30, str(file))
