"""Pictures of a study: curves, strips, slices, and bars."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch

from nsm.compare.bars import plot_bars
from nsm.compare.course import plot_courses
from nsm.compare.plan import Study
from nsm.compare.results import Result
from nsm.compare.topology import plot_changes
from nsm.plots.curves import plot_volume_curves
from nsm.plots.strip import try_strip


def draw_pair(
    study: Study,
    pair: str,
    shown: Sequence[Result],
    methods: Sequence[str],
    strip: dict[str, Any],
    progress: Callable[[str], object],
) -> list[Path]:
    """Draw volume curves (figure 10 of the paper) and a strip with a row per method (figures 7 and 8).

    Further pictures show quality over the time of training, and the residuals at changes of topology (figure 11).
    Curves, strips, and slices are of the first seed that each method has.

    Returns:
        The pictures.
    """
    folder, first = study.folder, first_results(shown, pair, methods)
    if not first:
        return []
    progress(f"volume curves of {pair}")
    curves, picture, course = (folder / f"{kind}_{pair}.png" for kind in ("volume", "strip", "course"))
    plot_volume_curves(curves, {r.method: (torch.tensor(r.times), torch.tensor(r.volumes)) for r in first})
    files = [curves]
    progress(f"strip of {pair}")
    morphs = {result.method: result.morph() for result in first}
    if try_strip(picture, morphs, strip["times"], size=strip["size"]):
        files.append(picture)
    progress(f"quality over time of {pair}")
    if plot_courses(course, [result for result in shown if result.pair == pair], methods):
        files.append(course)
    progress(f"changes of topology of {pair}")
    return files + plot_changes(folder, pair, first, study.slices, lambda result: morphs[result.method])


def first_results(shown: Sequence[Result], pair: str, methods: Sequence[str]) -> list[Result]:
    """Result of the first seed that each method has on a pair, in the order of the methods."""
    first = {result.method: result for result in reversed(shown) if result.pair == pair}
    return [first[method] for method in methods if method in first]


def draw_times(folder: Path, shown: Sequence[Result]) -> list[Path]:
    """Draw the times of training and of a step as bars."""
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
