"""``python -m nsm.export``: write a morph to files for other programs."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from nsm.cli import entry
from nsm.cli.errors import InputError
from nsm.cli.settings import choice, morph_times, use_threads
from nsm.export.formats import FORMATS
from nsm.export.request import Format, Request
from nsm.io.loading import LoadedMorph, load_morphs, output_folder, retimed
from nsm.shapes.download import file_sha256
from nsm.types import Morph

log = logging.getLogger(__name__)


def main(cfg: DictConfig) -> None:
    """Load a morph and write it in one format."""
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    times = morph_times("times", config["times"])
    use_threads(config)
    if config["format"] is not None:
        choice("format", config["format"], FORMATS)
    loaded = _one(retimed(load_morphs(config, "nsm.export"), config["timing"]))
    chosen = _format(config["format"], loaded.morph.dim)
    morph = loaded.morph
    if chosen.holds_networks and loaded.network is not None:
        log.info("`format=%s` holds the networks, so its ends are theirs (`ends=network`)", config["format"])
        morph = loaded.network
    request = Request(
        morph=morph,
        output=Path(config["output"]) if config["output"] else output_folder([loaded], "export"),
        times=times,
        resolution=chosen.resolution if config["resolution"] is None else config["resolution"],
        coordinates=chosen.coordinates if config["coordinates"] is None else config["coordinates"],
        exact_volume=config["exact_volume"],
        advect=_advect(config["advect"], chosen, morph, config["exact_volume"]),
        correspondences=config["advect"] is True,
        mesh=config["mesh"],
        project=config["project"],
        seconds=config["seconds"],
        labels=_labels(config["labels"], chosen),
        identity={
            "morph": _content(loaded),
            "growth": config["growth"],
            "timing": config["timing"],
            "ends": config["ends"],
        },
    )
    chosen.export(request)


def _format(name: str | None, dim: int) -> Format:
    """The format of a name, or the first that can hold morphs of the dimension."""
    fitting = {known: format for known, format in FORMATS.items() if dim in format.dims}
    if name is not None and name not in fitting:
        raise InputError(
            f"`format` must be one of {', '.join(fitting)} for a morph in {dim}D, got {name}. Try "
            f"`format={next(iter(fitting))}`."
        )
    return fitting[name or next(iter(fitting))]


def _one(loaded_morphs: list[LoadedMorph]) -> LoadedMorph:
    if len(loaded_morphs) > 1:
        raise InputError(f"`checkpoint` and `official` must name one morph, got {len(loaded_morphs)}. Try one of them.")
    return loaded_morphs[0]


def _advect(value: bool | None, chosen: Format, morph: Morph, exact_volume: bool) -> bool:
    """The setting ``advect``; if it is null, whether the format advects by default and the morph can."""
    if value is not None:
        return value
    if not chosen.advects or exact_volume:
        return False
    if not morph.has_velocity:
        log.info("this morph has no velocity to advect a mesh, so each time is a mesh of its own (`advect=false`)")
        return False
    return True


def _labels(value: str | None, chosen: Format) -> str | None:
    """The setting ``labels``, which only the format that carries labels may have."""
    if value is not None and not chosen.carries_labels:
        raise InputError(
            f"`labels` must come with `format=labels`, got {value} without it. Try `format=labels labels={value}`."
        )
    return value


def _content(loaded: LoadedMorph) -> str:
    """Identity of a morph: the hash of its checkpoint, or the name of a published one, whose files are verified."""
    file = Path(loaded.origin)
    return file_sha256(file) if file.is_file() else loaded.origin


if __name__ == "__main__":
    entry.run(main, "export")
