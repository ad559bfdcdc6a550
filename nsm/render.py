"""``python -m nsm.render``: trained morphs as strips, films and turning shapes, and slices of their residuals."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from datetime import datetime
from functools import cache, partial
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torch import Tensor

from nsm import entry
from nsm.errors import InputError
from nsm.frames import ExactVolume, Levels
from nsm.metrics import even_times
from nsm.subjects import Subject, load_subjects, whole_number
from nsm.types import Morph
from nsm.writers import Look, Pace, Plane, plot_residual_slices, render_film, render_strip, render_turntable
from nsm.writers.colours import RESIDUALS, position_colours, residual_colours, surface_bounds
from nsm.writers.look import Colours, carried, clay, zero_levels

log = logging.getLogger(__name__)

#: What draws, told how many of how many pictures are done.
Tell = Callable[[int, int], object]


def main(cfg: DictConfig) -> None:
    """Load and draw."""
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    if config["threads"] is not None:
        torch.set_num_threads(whole_number("threads", config["threads"], 1))
    kind = config["kind"]
    draw, suffix = KINDS[kind]
    subjects = load_subjects(config, "nsm.render")
    file = Path(config["output"]) if config["output"] else _default_folder(subjects) / f"{kind}{suffix}"
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(f"drawing the {kind}", total=None)
        draw(file, subjects, config, lambda done, total: bar.update(task, completed=done, total=total))
    log.info("wrote %s", file)


def _strip(file: Path, subjects: list[Subject], config: Mapping[str, Any], tell: Tell) -> None:
    size, times = whole_number("size", config["size"], 16), _times(config["times"])
    render_strip(file, _rows(subjects), times, size=size, look=_look(config), progress=tell)


def _film(file: Path, subjects: list[Subject], config: Mapping[str, Any], tell: Tell) -> None:
    seconds, hold, turns = (_number(config, name) for name in ("seconds", "hold", "turns"))
    pace = Pace(seconds, hold, whole_number("fps", config["fps"], 1), bool(config["back"]), turns)
    render_film(file, _rows(subjects), pace=pace, size=_numbers(config, "size"), look=_look(config), progress=tell)


def _turntable(file: Path, subjects: list[Subject], config: Mapping[str, Any], tell: Tell) -> None:
    time, seconds = _time(_number(config, "time")), _number(config, "seconds")
    fps, size = whole_number("fps", config["fps"], 1), _numbers(config, "size")
    render_turntable(
        file, _rows(subjects), time, seconds=seconds, fps=fps, size=size, look=_look(config), progress=tell
    )


def _slices(file: Path, subjects: list[Subject], config: Mapping[str, Any], tell: Tell) -> None:
    plane, times = Plane(str(config["axis"]), _number(config, "offset")), _times(config["times"])
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
    return position_colours(points, surface_bounds(morph, 0.0))


#: What ``colour`` may be.
COLOURS: Mapping[str, Colours] = {
    "clay": clay,
    "position": _position,
    "carried": carried,
} | {name: partial(residual_colours, what=name) for name in RESIDUALS}


def _look(config: Mapping[str, Any]) -> Look:
    resolution = whole_number("resolution", config["resolution"], 8)
    if config["colour"] not in COLOURS:
        raise InputError(f"colour={config['colour']} is not known: give one of {', '.join(COLOURS)}")
    return Look(
        resolution,
        COLOURS[config["colour"]],
        _exact_levels(resolution) if config["exact_volume"] else zero_levels,
        _numbers(config, "view"),
        _numbers(config, "up"),
        _number(config, "zoom"),
    )


def _exact_levels(resolution: int) -> Callable[[Morph], Levels]:
    """Levels of the wanted volume, each found once however often a morph's picture asks."""
    known: dict[Morph, Levels] = {}

    def levels(morph: Morph) -> Levels:
        if morph not in known:
            known[morph] = cache(ExactVolume(morph, resolution))
        return known[morph]

    return levels


def _rows(subjects: list[Subject]) -> Morph | dict[str, Morph]:
    """Morphs by name; one needs none."""
    return subjects[0].morph if len(subjects) == 1 else {subject.name: subject.morph for subject in subjects}


def _times(given: Any) -> list[float]:
    """Times from a count or a list."""
    if isinstance(given, int) and not isinstance(given, bool) and given >= 1:
        return even_times(given).tolist()
    if isinstance(given, list) and given:
        return [_time(time) for time in given]
    raise InputError(f"times={given} names no times: give how many, such as times=7, or a list such as [0,0.5,1]")


def _time(given: Any) -> float:
    if isinstance(given, bool) or not isinstance(given, (int, float)) or not 0 <= given <= 1:
        raise InputError(f"the time {given} is none of a morph: give a number from 0 to 1, such as 0.5")
    return float(given)


def _number(config: Mapping[str, Any], name: str) -> float:
    value = config[name]
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{name}={value} is no number: give one such as 1.5")
    return float(value)


def _numbers(config: Mapping[str, Any], name: str) -> list[Any]:
    values = config[name]
    if not isinstance(values, list) or any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in values):
        raise InputError(f"{name}={values} is no list of numbers: give one such as [1,2]")
    return values


def _default_folder(subjects: list[Subject]) -> Path:
    """``render`` in the folder of a run that is drawn alone, else a folder of its own."""
    if len(subjects) == 1 and subjects[0].folder is not None:
        return subjects[0].folder / "render"
    name = Path(subjects[0].origin).name if len(subjects) == 1 else datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    return Path("outputs") / "renders" / name


if __name__ == "__main__":
    entry.run(main, "render")
