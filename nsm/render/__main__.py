"""``python -m nsm.render``: trained morphs as strips, films and turning shapes, and slices of their residuals."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torch import Tensor

from nsm.cli import entry
from nsm.cli.errors import InputError
from nsm.cli.settings import moment, moments, number, numbers, switch, use_threads, whole_number
from nsm.io.loading import LoadedMorph, load_morphs, output_folder
from nsm.morphs.surfaces import ExactVolume, Levels
from nsm.plots.colors import RESIDUALS, position_colors, residual_colors, surface_bounds
from nsm.plots.look import Colors, Look, carried, clay, zero_levels
from nsm.plots.slices import Plane, plot_residual_slices
from nsm.plots.strip import render_strip
from nsm.render.film import Pace, render_film, render_turntable
from nsm.types import Morph

log = logging.getLogger(__name__)

#: What draws, told how many of how many pictures are done.
Tell = Callable[[int, int], object]


def main(cfg: DictConfig) -> None:
    """Load and draw."""
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    use_threads(config)
    kind = config["kind"]
    draw, suffix = KINDS[kind]
    subjects = load_morphs(config, "nsm.render")
    file = Path(config["output"]) if config["output"] else output_folder(subjects, "render") / f"{kind}{suffix}"
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(f"drawing the {kind}", total=None)
        draw(file, subjects, config, lambda done, total: bar.update(task, completed=done, total=total))
    log.info("wrote %s", file)


def _strip(file: Path, subjects: list[LoadedMorph], config: Mapping[str, Any], tell: Tell) -> None:
    size, times = whole_number("size", config["size"], 16), moments("times", config["times"])
    render_strip(file, _rows(subjects), times, size=size, look=_look(config), progress=tell)


def _film(file: Path, subjects: list[LoadedMorph], config: Mapping[str, Any], tell: Tell) -> None:
    seconds, hold, turns = (number(name, config[name]) for name in ("seconds", "hold", "turns"))
    pace = Pace(seconds, hold, whole_number("fps", config["fps"], 1), switch("back", config["back"]), turns)
    render_film(
        file, _rows(subjects), pace=pace, size=numbers("size", config["size"]), look=_look(config), progress=tell
    )


def _turntable(file: Path, subjects: list[LoadedMorph], config: Mapping[str, Any], tell: Tell) -> None:
    time, seconds = moment("time", config["time"]), number("seconds", config["seconds"])
    fps, size = whole_number("fps", config["fps"], 1), numbers("size", config["size"])
    render_turntable(
        file, _rows(subjects), time, seconds=seconds, fps=fps, size=size, look=_look(config), progress=tell
    )


def _slices(file: Path, subjects: list[LoadedMorph], config: Mapping[str, Any], tell: Tell) -> None:
    plane, times = Plane(str(config["axis"]), number("offset", config["offset"])), moments("times", config["times"])
    tell(0, 1)
    plot_residual_slices(
        file, _rows(subjects), times, plane, resolution=whole_number("resolution", config["resolution"], 16)
    )
    tell(1, 1)


#: How each kind of picture is drawn, and the suffix of its file unless told otherwise.
KINDS = {
    "strip": (_strip, ".png"),
    "film": (_film, ".mp4"),
    "turntable": (_turntable, ".mp4"),
    "slices": (_slices, ".png"),
}


def _position(morph: Morph, points: Tensor, time: float) -> Tensor:
    return position_colors(points, surface_bounds(morph, 0.0))


#: What ``color`` may be.
COLORS: Mapping[str, Colors] = {
    "clay": clay,
    "position": _position,
    "carried": carried,
} | {name: partial(residual_colors, what=name) for name in RESIDUALS}


def _look(config: Mapping[str, Any]) -> Look:
    resolution = whole_number("resolution", config["resolution"], 8)
    if config["color"] not in COLORS:
        raise InputError(f"color={config['color']} is not known: give one of {', '.join(COLORS)}")
    return Look(
        resolution,
        COLORS[config["color"]],
        _exact_levels(resolution) if switch("exact_volume", config["exact_volume"]) else zero_levels,
        numbers("view", config["view"]),
        numbers("up", config["up"]),
        number("zoom", config["zoom"]),
    )


def _exact_levels(resolution: int) -> Callable[[Morph], Levels]:
    """Levels of the wanted volume, each found once however often a morph's picture asks."""
    known: dict[Morph, Levels] = {}

    def levels(morph: Morph) -> Levels:
        if morph not in known:
            known[morph] = cache(ExactVolume(morph, resolution))
        return known[morph]

    return levels


def _rows(subjects: list[LoadedMorph]) -> Morph | dict[str, Morph]:
    """Morphs by name; one needs none."""
    return subjects[0].morph if len(subjects) == 1 else {subject.name: subject.morph for subject in subjects}


if __name__ == "__main__":
    entry.run(main, "render")
