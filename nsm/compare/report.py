"""Report of a study: tables, curves, strips, times, and a page that shows them."""

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
from nsm.cli.files import atomic_write
from nsm.compare.choices import OFFICIAL
from nsm.compare.course import course_table
from nsm.compare.goals import goals_table
from nsm.compare.paper import paper_lines, paper_table
from nsm.compare.pictures import draw_pair, draw_times, first_results
from nsm.compare.plan import Job, Study
from nsm.compare.rates import rates_table
from nsm.compare.results import Result, described
from nsm.compare.tabulate import figure_names, figure_table, overview, terms_table, times_table
from nsm.compare.topology import RADIUS, changes_table
from nsm.plots.tables import Table, markdown, write_table

#: Figures whose tables the page shows first, those of table 9 of the paper.
_FIRST = ("volume std", "volume max")
#: Sentences above the tables of a pair, by the end of the name of their files.
_HEADS = {
    "": "",
    "_times": "Times:\n\n",
    "_terms": "Weighted terms of the loss at the end of training:\n\n",
    "_rates": "Validation error of the first seed by learning rate, the best of which all seeds have:\n\n",
    "_course": "Validation error and volume after parts of the steps:\n\n",
    "_changes": f"Changes of topology, and the mean residuals within {RADIUS:g} of each and in the box:\n\n",
}
#: Volume outside the box of a morph over V(0) above which the page says so.
_OUTSIDE = 1e-3
#: Explanation of values over several seeds.
_SEEDS = "mean ± standard deviation (least–greatest); differences within that spread are not significant"
#: Libraries on whose versions results may depend.
_LIBRARIES = ("torch", "lightning", "hydra-core", "pytorch-optimizer", "geomloss")


def write_report(
    study: Study,
    settings: dict[str, Any],
    results: Sequence[Result],
    tries: Sequence[Job],
    strip: dict[str, Any],
    progress: Callable[[str], object],
) -> list[Path]:
    """Write the report into the folder of the study.

    Args:
        study: The study.
        settings: Its whole configuration, as values that JSON can hold.
        results: Results of all runs and official morphs.
        tries: Runs that tried learning rates.
        strip: Keyword arguments ``times`` and ``size`` of the strips.
        progress: Called with the name of each part as it begins.

    Returns:
        The files, with the page first.
    """
    folder = study.folder
    methods = [method.name for method in study.methods] + ([OFFICIAL] if study.official else [])
    pairs = [pair.name for pair in study.pairs]
    facts = _facts(study)
    with atomic_write(folder / "study.json") as temporary:
        content = {**facts, "settings": settings, "rows": described(results)}
        temporary.write_text(json.dumps(content, indent=2) + "\n")

    progress("tables")
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
            "_rates": rates_table(pair, tries, methods),
            "_course": course_table(pair, results, methods),
            "_changes": changes_table(pair, first_results(shown, pair, methods), study.slices, Result.morph),
        }
        tables = {name: table for name, table in tables.items() if table.cells}
        for name, table in tables.items():
            files += write_table(folder / "pairs" / f"{pair}{name}", table)
        pictures = draw_pair(study, pair, shown, methods, strip, progress)
        files += pictures
        sections.append(_section(pair, tables, [file.name for file in pictures]))
    files += draw_times(folder, shown)
    beside = paper_table(results, study.printed)
    if beside.cells:
        files += write_table(folder / "tables" / "paper", beside)
    page = folder / "README.md"
    paper = ["## Beside the paper", "", markdown(beside), *paper_lines(results, study.printed)] if beside.cells else []
    text = _page(study, facts, results, goals, by_figure, paper, sections, (folder / "times.png") in files)
    with atomic_write(page) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return [page, folder / "study.json", *files]


def _facts(study: Study) -> dict[str, Any]:
    """Collect the machine, the versions, and the protocol on which results depend."""
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


def _page(
    study: Study,
    facts: dict[str, Any],
    results: Sequence[Result],
    goals: Table,
    tables: dict[str, Table],
    paper: Sequence[str],
    sections: Sequence[str],
    timed: bool,
) -> str:
    threads = {None: "all threads", 1: "1 thread"}.get(study.threads, f"{study.threads} threads")
    head = [
        f"# Study {study.name}",
        "",
        f"Each run: {study.budget}, on {threads} of a machine with {facts['cores']} cores ({facts['device']}); "
        f"nsm {facts['versions']['nsm']}, torch {facts['versions']['torch']}. Volumes on "
        f"{study.protocol.volume_resolution} cells along the box at {study.protocol.times} times, ends on "
        f"{study.protocol.surface_resolution}; the checkpoint of each run is best.ckpt"
        + _of_rates(study)
        + (f"; seeds {', '.join(map(str, study.seeds))}: {_SEEDS}" if len(study.seeds) > 1 else "")
        + ". The best value of each column is in bold. `study.json` holds all results and settings.",
        "",
    ]
    if missing := [r for r in results if r.reason is not None]:
        head += ["## Not compared", "", "| pair | method | seed | reason |", "| --- | --- | --- | --- |"]
        head += [
            f"| {r.pair} | {r.method} | {'' if r.seed is None else r.seed} | {_in_cell(str(r.reason))} |"
            for r in missing
        ]
        head.append("")
    if cut := outside_box(results):
        named = ", ".join(f"{row} ({share:.1%})" for row, share in cut.items())
        head += [
            "These leave the box in which volumes are measured, which do not count what is outside (here in parts of "
            f"V(0)): {named}.",
            "",
        ]
    if len(study.pairs) > 1 and goals.cells:
        head += ["## All pairs", "", f"{goals.title}.", "", markdown(goals)]
    for name in _FIRST:
        if name in tables:
            head += [f"## {name}", "", f"{tables[name].title}.", "", markdown(tables[name])]
    head += paper
    tail = ["## Times", "", "![Training times and step times](times.png)", ""] if timed else []
    names = [f"[{name}](tables/{_slug(name)}.md)" for name in tables]
    tail += ["## All figures", "", "Each as .md, .csv, and .tex: " + ", ".join(names) + ".", ""] if names else []
    return "\n".join([*head, *sections, *tail])


def outside_box(results: Sequence[Result]) -> dict[str, float]:
    """Greatest volume outside the box over all seeds, by the names of pairs and methods, where it is notable."""
    shares: dict[str, float] = {}
    for result in results:
        row, share = f"{result.pair}/{result.method}", result.figures.get("volume beyond") or 0.0
        if share > _OUTSIDE:
            shares[row] = max(share, shares.get(row, 0.0))
    return shares


def _of_rates(study: Study) -> str:
    if not study.learning_rates:
        return ""
    rates = ", ".join(f"{rate:g}" for rate in study.learning_rates)
    return f"; each method with its own best of the learning rates {rates}"


def _section(pair: str, tables: dict[str, Table], pictures: Sequence[str]) -> str:
    lines = [f"## {pair}", ""]
    lines += [f"![{name}]({name})\n" for name in pictures]
    lines += [_HEADS[name] + markdown(table) for name, table in tables.items()]
    return "\n".join(lines)


def _slug(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "_", name.replace("%", " percent")).strip("_")


def _in_cell(text: str) -> str:
    return " ".join(text.replace("|", r"\|").split())
