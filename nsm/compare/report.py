"""One folder that shows a study: tables, curves, strips, times, and a page that leads through them."""

from __future__ import annotations

import json
import os
import platform
import re
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

import nsm
from nsm.cli.files import whole_file
from nsm.compare.bars import plot_bars
from nsm.compare.goals import goals_table
from nsm.compare.plan import OFFICIAL, Study
from nsm.compare.results import Result, described
from nsm.compare.tabulate import figure_names, figure_table, overview, terms_table, times_table
from nsm.plots.curves import plot_volume_curves
from nsm.plots.strip import try_strip
from nsm.plots.tables import Table, markdown, write_table

#: The figures of the paper's table 9, which the page of a study begins with.
_FIRST = ("volume std", "volume max")
#: How figures of several seeds read.
_SEEDS = "mean ± standard deviation (least–greatest), and a difference within that spread is none"
#: Libraries whose version a result may depend on.
_LIBRARIES = ("torch", "lightning", "hydra-core", "pytorch-optimizer", "geomloss")


def write_report(
    study: Study,
    settings: dict[str, Any],
    results: Sequence[Result],
    strip: dict[str, Any],
    tell: Callable[[str], object],
) -> list[Path]:
    """Write everything into the study's folder; returns the files, the page to read first.

    Args:
        study: what was asked for.
        settings: its whole configuration, as plain values.
        results: of all runs and official morphs.
        strip: ``times`` and ``size`` of the strips.
        tell: is told what is being written.
    """
    folder = study.folder
    methods = [method.name for method in study.methods] + ([OFFICIAL] if study.official else [])
    pairs = [pair.name for pair in study.pairs]
    facts = _facts(study)
    with whole_file(folder / "study.json") as temporary:
        content = {**facts, "settings": settings, "rows": described(results)}
        temporary.write_text(json.dumps(content, indent=2) + "\n")

    tell("tables")
    shown = [r for r in results if r.reason is None]
    by_figure = {name: figure_table(name, results, pairs, methods) for name in figure_names(results)}
    files = [file for name, table in by_figure.items() for file in write_table(folder / "tables" / _slug(name), table)]
    goals = goals_table(results, pairs, methods)
    files += write_table(folder / "tables" / "all", goals)
    sections = []
    for pair in pairs:
        tables = {
            "": overview(pair, results, methods),
            "_times": times_table(pair, results, methods),
            "_terms": terms_table(pair, results, methods),
        }
        tables = {name: table for name, table in tables.items() if table.cells}
        for name, table in tables.items():
            files += write_table(folder / "pairs" / f"{pair}{name}", table)
        pictures = _pictures(folder, pair, shown, methods, strip, tell)
        files += pictures
        sections.append(_section(pair, tables, [file.name for file in pictures]))
    files += _times(folder, shown)
    page = folder / "README.md"
    text = _page(study, facts, results, goals, by_figure, sections, (folder / "times.png") in files)
    with whole_file(page) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return [page, folder / "study.json", *files]


def _facts(study: Study) -> dict[str, Any]:
    """The machine and the versions that a result depends on."""
    return {
        "study": study.name,
        "budget": str(study.budget),
        "versions": {
            "nsm": nsm.__version__,
            "python": platform.python_version(),
            **{name: version(name) for name in _LIBRARIES},
        },
        "cores": os.cpu_count(),
        "threads": study.threads,
        "device": torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu",
        "evaluation": study.protocol.describe() | {"ends": study.ends},
    }


def _pictures(
    folder: Path,
    pair: str,
    shown: Sequence[Result],
    methods: Sequence[str],
    strip: dict[str, Any],
    tell: Callable[[str], object],
) -> list[Path]:
    """Volume curves (figure 10) and a strip with a row a method (figures 7, 8), of the first seed that is there."""
    first = {r.method: r for r in reversed(shown) if r.pair == pair}
    first = {method: first[method] for method in methods if method in first}
    if not first:
        return []
    tell(f"volume curves of {pair}")
    curves, picture = folder / f"volume_{pair}.png", folder / f"strip_{pair}.png"
    plot_volume_curves(curves, {name: (torch.tensor(r.times), torch.tensor(r.volumes)) for name, r in first.items()})
    tell(f"strip of {pair}")
    morphs = {name: r.morph() for name, r in first.items()}
    return [curves, picture] if try_strip(picture, morphs, strip["times"], size=strip["size"]) else [curves]


def _times(folder: Path, shown: Sequence[Result]) -> list[Path]:
    minutes: dict[str, dict[str, float]] = {}
    steps: dict[str, dict[str, float]] = {}
    for result in reversed(shown):
        if result.training_s is not None:
            minutes.setdefault(result.method, {})[result.pair] = result.training_s / 60
        if result.step_s is not None:
            steps.setdefault(result.method, {})[result.pair] = 1000 * result.step_s
    order = dict.fromkeys(r.method for r in shown)
    pairs = dict.fromkeys(r.pair for r in shown)
    panels = {
        label: {m: {p: values[m][p] for p in pairs if p in values[m]} for m in order if m in values}
        for label, values in (("training in minutes", minutes), ("one step in ms", steps))
        if values
    }
    if not panels:
        return []
    plot_bars(folder / "times.png", panels)
    return [folder / "times.png"]


def _page(
    study: Study,
    facts: dict[str, Any],
    results: Sequence[Result],
    goals: Table,
    tables: dict[str, Table],
    sections: Sequence[str],
    timed: bool,
) -> str:
    threads = f"threads of a run: {study.threads}" if study.threads else "all of them for each run"
    head = [
        f"# Study {study.name}",
        "",
        f"{study.budget} for each run, on a machine of {facts['cores']} cores ({facts['device']}), {threads}; "
        f"nsm {facts['versions']['nsm']}, torch {facts['versions']['torch']}. Volumes on "
        f"{study.protocol.volume_resolution} cells along the box at {study.protocol.times} times, ends on "
        f"{study.protocol.surface_resolution}; of each run best.ckpt"
        + (f"; seeds {', '.join(map(str, study.seeds))}: {_SEEDS}" if len(study.seeds) > 1 else "")
        + ". The best of each column is in bold. `study.json` has everything.",
        "",
    ]
    if missing := [r for r in results if r.reason is not None]:
        head += ["## Not compared", "", "| pair | method | seed | why |", "| --- | --- | --- | --- |"]
        head += [
            f"| {r.pair} | {r.method} | {'' if r.seed is None else r.seed} | {_in_cell(str(r.reason))} |"
            for r in missing
        ]
        head.append("")
    if len(study.pairs) > 1 and goals.cells:
        head += ["## All pairs", "", f"{goals.title}.", "", markdown(goals)]
    for name in _FIRST:
        if name in tables:
            head += [f"## {name}", "", f"{tables[name].title}.", "", markdown(tables[name])]
    tail = ["## Times", "", "![Training times and step times](times.png)", ""] if timed else []
    names = [f"[{name}](tables/{_slug(name)}.md)" for name in tables]
    tail += ["## All figures", "", "Each as .md, .csv and .tex: " + ", ".join(names) + ".", ""] if names else []
    return "\n".join([*head, *sections, *tail])


def _section(pair: str, tables: dict[str, Table], pictures: Sequence[str]) -> str:
    lines = [f"## {pair}", ""]
    lines += [f"![{name}]({name})\n" for name in pictures]
    heads = {"": "", "_times": "Times:\n\n", "_terms": "Weighted terms of the loss at the end of training:\n\n"}
    lines += [heads[name] + markdown(table) for name, table in tables.items()]
    return "\n".join(lines)


def _slug(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "_", name.replace("%", " percent")).strip("_")


def _in_cell(text: str) -> str:
    return " ".join(text.replace("|", r"\|").split())
