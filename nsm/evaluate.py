"""``python -m nsm.evaluate``: all quality figures of trained morphs, ours and the authors', side by side."""

from __future__ import annotations

import csv
import json
import logging
from datetime import datetime
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

import nsm
from nsm import entry
from nsm.files import whole_file
from nsm.metrics import Evaluation, evaluate_morph, table
from nsm.subjects import Subject, load_subjects, whole_number
from nsm.writers import plot_volume_curves, render_strip

log = logging.getLogger(__name__)

#: The least that each setting of the protocol may be.
_LEAST = {"volume_resolution": 8, "surface_resolution": 8, "times": 2}
#: Characters that the names of the figures and the numbers of one morph take.
_NAMES_WIDTH, _COLUMN_WIDTH = 32, 14


def main(cfg: DictConfig) -> None:
    """Load, measure, show and write."""
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    protocol = {name: whole_number(name, config[name], least) for name, least in _LEAST.items()}
    whole_number("picture_size", config["picture_size"], 16)
    if config["threads"] is not None:
        torch.set_num_threads(whole_number("threads", config["threads"], 1))
    subjects = load_subjects(config["checkpoint"], config["official"], "nsm.evaluate")
    folder = Path(config["output"]) if config["output"] else _default_folder(subjects)
    results = _measure(subjects, protocol)
    _show(results, protocol)
    for file in _write(folder, subjects, results, protocol, config["picture_size"]):
        log.info("wrote %s", file)


def _measure(subjects: list[Subject], protocol: dict[str, int]) -> dict[str, Evaluation]:
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    results = {}
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=len(subjects))
        for subject in subjects:

            def tell(stage: str, name: str = subject.name) -> None:
                bar.update(task, description=f"{name}: {stage}".replace("[", r"\["))

            results[subject.name] = evaluate_morph(subject.morph, **protocol, progress=tell)
            bar.advance(task)
    return results


def _show(results: dict[str, Evaluation], protocol: dict[str, int]) -> None:
    """Print the table, in parts where a terminal is too narrow for all columns at once."""
    title = "volume on {volume_resolution}^d cells at {times} times, ends on {surface_resolution}^d".format(**protocol)
    console = Console()
    if not console.is_terminal:
        console = Console(width=_NAMES_WIDTH + _COLUMN_WIDTH * len(results))
    names, side_by_side = list(results), max(1, (console.width - _NAMES_WIDTH) // _COLUMN_WIDTH)
    for first in range(0, len(names), side_by_side):
        part = table({n: results[n].figures() for n in names[first : first + side_by_side]}, title=title)
        for column in part.columns:
            column.overflow = "fold"
        console.print(part)


def _write(
    folder: Path,
    subjects: list[Subject],
    results: dict[str, Evaluation],
    protocol: dict[str, int],
    picture_size: int,
) -> list[Path]:
    """Write figures, curves and pictures into a folder; returns the files."""
    metrics, rows, plot = folder / "metrics.json", folder / "volume.csv", folder / "volume.png"
    morphs = {s.name: {"origin": s.origin, **results[s.name].to_dict()} for s in subjects}
    with whole_file(metrics) as temporary:
        temporary.write_text(json.dumps({"version": nsm.__version__, "protocol": protocol, "morphs": morphs}, indent=2))
    curves = {name: result.volume for name, result in results.items()}
    with whole_file(rows) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["morph", "time", "volume", "deviation"])
        for name, curve in curves.items():
            columns = (curve.times.tolist(), curve.volumes.tolist(), curve.deviations.tolist())
            writer.writerows([name, *(f"{number:.9g}" for number in row)] for row in zip(*columns, strict=True))
    plot_volume_curves(plot, {name: (curve.times, curve.volumes) for name, curve in curves.items()})
    dims = sorted({s.morph.dim for s in subjects})
    strips = [folder / ("strip.png" if len(dims) == 1 else f"strip_{dim}d.png") for dim in dims]
    with Console(stderr=True).status("drawing the morphs"):
        for dim, strip in zip(dims, strips, strict=True):
            render_strip(strip, {s.name: s.morph for s in subjects if s.morph.dim == dim}, size=picture_size)
    return [metrics, rows, plot, *strips]


def _default_folder(subjects: list[Subject]) -> Path:
    """``evaluation`` in the folder of a run that is looked at alone, else a new folder."""
    if len(subjects) == 1 and subjects[0].folder is not None:
        return subjects[0].folder / "evaluation"
    return Path("outputs") / "evaluations" / datetime.now().strftime("%Y-%m-%d_%H-%M-%S")


if __name__ == "__main__":
    entry.run(main, "evaluate")
