"""``python -m nsm.render``: draw morphs as strips, films, and turntables, and slices of their residuals."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from nsm.cli import entry
from nsm.cli.locks import only_writer_of_file
from nsm.cli.progress import Progress
from nsm.cli.settings import morph_times, numbers, use_threads, whole_number
from nsm.io.loading import LoadedMorph, load_morphs, output_folder, retimed
from nsm.morphs.surfaces import ExactVolume, Levels
from nsm.plots.colors import color_function
from nsm.plots.look import Look, zero_levels
from nsm.plots.slices import SlicePlane, plot_residual_slices
from nsm.plots.strip import render_strip
from nsm.render.film import Pace, render_film, render_turntable
from nsm.types import Morph

log = logging.getLogger(__name__)

#: Called with the number of pictures done and their total.
Report = Callable[[int, int], object]


def main(cfg: DictConfig) -> None:
    """Load the morphs that the settings name and draw them."""
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    use_threads(config)
    kind = config["kind"]
    draw, suffix = KINDS[kind]
    loaded = retimed(load_morphs(config, "nsm.render"), config["timing"])
    file = Path(config["output"]) if config["output"] else output_folder(loaded, "render") / f"{kind}{suffix}"
    with only_writer_of_file(file), Progress(f"drawing the {kind}", unit="pictures") as progress:
        draw(file, loaded, config, progress.update)
    log.info("wrote %s", file)


def _strip(file: Path, loaded: list[LoadedMorph], config: Mapping[str, Any], report: Report) -> None:
    size = whole_number("size", config["size"], 16)  # not the width and height of a film
    render_strip(
        file, _rows(loaded), morph_times("times", config["times"]), size=size, look=_look(config), progress=report
    )


def _film(file: Path, loaded: list[LoadedMorph], config: Mapping[str, Any], report: Report) -> None:
    pace = Pace(config["seconds"], config["hold"], config["fps"], config["back"], config["turns"])
    size = numbers("size", config["size"])  # not the width of a picture of a strip
    render_film(file, _rows(loaded), pace=pace, size=size, look=_look(config), progress=report)


def _turntable(file: Path, loaded: list[LoadedMorph], config: Mapping[str, Any], report: Report) -> None:
    render_turntable(
        file,
        _rows(loaded),
        config["time"],
        seconds=config["seconds"],
        fps=config["fps"],
        size=numbers("size", config["size"]),
        look=_look(config),
        progress=report,
    )


def _slices(file: Path, loaded: list[LoadedMorph], config: Mapping[str, Any], report: Report) -> None:
    plane, times = SlicePlane(config["axis"], config["offset"]), morph_times("times", config["times"])
    report(0, 1)
    plot_residual_slices(file, _rows(loaded), times, plane, resolution=config["resolution"])
    report(1, 1)


#: Function that draws each kind of picture, and the default suffix of its file.
KINDS = {
    "strip": (_strip, ".png"),
    "film": (_film, ".mp4"),
    "turntable": (_turntable, ".mp4"),
    "slices": (_slices, ".png"),
}


def _look(config: Mapping[str, Any]) -> Look:
    return Look(
        config["resolution"],
        color_function(config["color"]),
        _exact_levels(config["resolution"]) if config["exact_volume"] else zero_levels,
        config["view"],
        config["up"],
        config["zoom"],
    )


def _exact_levels(resolution: int) -> Callable[[Morph], Levels]:
    """Levels at which surfaces have the wanted volume, each computed only once."""
    known: dict[Morph, Levels] = {}

    def levels(morph: Morph) -> Levels:
        if morph not in known:
            known[morph] = cache(ExactVolume(morph, resolution))
        return known[morph]

    return levels


def _rows(loaded: list[LoadedMorph]) -> Morph | dict[str, Morph]:
    """Morphs by name, or a single one without."""
    return loaded[0].morph if len(loaded) == 1 else {each.name: each.morph for each in loaded}


if __name__ == "__main__":
    entry.run(main, "render")
