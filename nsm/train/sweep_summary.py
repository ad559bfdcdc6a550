"""A table of all runs at the end of a multirun."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.table import Table

from nsm.cli.files import whole_file


class SweepSummary(Callback):
    """Collects the ``summary.json`` of every run below the sweep's folder into ``summary.csv``, and prints it.

    Beside its folder, each run is named by the overrides that are not those of all runs.
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
        with whole_file(folder / "summary.csv") as temporary, temporary.open("w", newline="") as table:
            writer = csv.writer(table)
            writer.writerow(["run", "varied", *names])
            for run, what, values in zip(runs, varied, figures, strict=True):
                writer.writerow([run, what, *(values.get(name, "") for name in names)])

        shown = Table(title=f"{len(runs)} runs in {folder}")
        shown.add_column("run")
        shown.add_column("varied", overflow="fold")
        for name in names:
            shown.add_column(name.removeprefix("val/"), justify="right")
        for run, what, values in zip(runs, varied, figures, strict=True):
            shown.add_row(run, what, *(f"{values[name]:.4g}" if name in values else "" for name in names))
        Console().print(shown)


def _number(file: Path) -> tuple[int, str]:
    """Runs in the order of their job numbers, which are the names of their folders."""
    name = file.parent.name
    return (int(name) if name.isdigit() else 1 << 30, str(file))


def _overrides(folder: Path) -> list[str]:
    file = folder / ".hydra" / "overrides.yaml"
    return [str(override) for override in OmegaConf.load(file)] if file.is_file() else []


def _varied(overrides: list[list[str]]) -> list[str]:
    """What distinguishes each run."""
    common = set.intersection(*map(set, overrides)) if len(overrides) > 1 else set()
    return [" ".join(o for o in run if o not in common) for run in overrides]
