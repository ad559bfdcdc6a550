"""Table of all runs at the end of a multirun."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.table import Table

from nsm.cli.files import atomic_write
from nsm.train.summary import FIGURES


class SweepSummary(Callback):
    """Collects the ``summary.json`` of all runs in the folder of a multirun into ``summary.csv``.

    Also prints a table of what varied between the runs and of the figures that matter.
    """

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Write and print the table."""
        folder = Path(config.hydra.sweep.dir)
        files = sorted(folder.rglob("summary.json"), key=_number)
        if not files:
            return
        figures = [json.loads(file.read_text()) for file in files]
        names = list(dict.fromkeys(name for run in figures for name in run))
        runs = [str(file.parent.relative_to(folder)) for file in files]
        varied = _varied([_overrides(file.parent) for file in files])
        with atomic_write(folder / "summary.csv") as temporary, temporary.open("w", newline="") as table:
            writer = csv.writer(table)
            writer.writerow(["run", "varied", *names])
            for run, overrides, values in zip(runs, varied, figures, strict=True):
                writer.writerow([run, overrides, *(values.get(name, "") for name in names)])

        Console().print(_table(f"{len(runs)} runs in {folder}", runs, varied, figures))


def _table(title: str, runs: list[str], varied: list[str], figures: list[dict[str, float]]) -> Table:
    """What was varied in each run, and the figures that matter."""
    shown = {name: short for name, short in FIGURES.items() if any(name in run for run in figures)}
    table = Table(title=title)
    table.add_column("run")
    table.add_column("varied", overflow="fold")
    for header, _ in shown.values():
        table.add_column(header, justify="right")
    for run, overrides, values in zip(runs, varied, figures, strict=True):
        cells = (text.format(values[name]) if name in values else "" for name, (_, text) in shown.items())
        table.add_row(run, overrides, *cells)
    return table


def _number(file: Path) -> tuple[int, str]:
    """Sort key for the order of job numbers, which are the names of the folders."""
    name = file.parent.name
    return (int(name) if name.isdigit() else 1 << 30, str(file))


def _overrides(folder: Path) -> list[str]:
    file = folder / ".hydra" / "overrides.yaml"
    return [str(override) for override in OmegaConf.load(file)] if file.is_file() else []


def _varied(overrides: list[list[str]]) -> list[str]:
    """Overrides of each run that not all runs share."""
    common = set.intersection(*map(set, overrides)) if len(overrides) > 1 else set()
    return [" ".join(o for o in run if o not in common) for run in overrides]
