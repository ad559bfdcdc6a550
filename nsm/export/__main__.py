"""``python -m nsm.export``: a morph as files for other programs."""

from __future__ import annotations

import logging
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from nsm.cli import entry
from nsm.cli.errors import InputError
from nsm.cli.settings import moments, positive, switch, use_threads, whole_number
from nsm.export import usd
from nsm.export.animation import Animation
from nsm.export.formats import Format, Request
from nsm.export.networks import write_onnx, write_pt2, write_safetensors
from nsm.export.program import Program
from nsm.export.sequence import Meshes
from nsm.io import gltf
from nsm.io.loading import LoadedMorph, load_morphs, output_folder
from nsm.shapes.download import file_sha256

log = logging.getLogger(__name__)

#: Every format by its name; the first that can hold a morph is its default.
FORMATS: dict[str, Format] = {
    "ply": Meshes("ply"),
    "obj": Meshes("obj", dims=(2, 3)),
    "stl": Meshes("stl"),
    "glb": Animation((".glb",), gltf.write_glb_frames, gltf.write_glb_carried),
    "usd": Animation(usd.SUFFIXES, usd.write_usd_frames, usd.write_usd_carried),
    "safetensors": Program("safetensors", write_safetensors),
    "pt2": Program("pt2", write_pt2),
    "onnx": Program("onnx", write_onnx),
}


def main(cfg: DictConfig) -> None:
    """Load one morph and write it in one format."""
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    times, resolution = moments("times", config["times"]), whole_number("resolution", config["resolution"], 2)
    use_threads(config)
    _require_known(config["format"])
    subject = _one(load_morphs(config, "nsm.export"))
    chosen = _format(config["format"], subject.morph.dim)
    morph = subject.morph
    if isinstance(chosen, Program) and subject.network is not None:
        log.info("format=%s holds the networks, so its ends are theirs, as with ends=network", config["format"])
        morph = subject.network
    request = Request(
        morph=morph,
        output=Path(config["output"]) if config["output"] else output_folder([subject], "export"),
        times=times,
        resolution=resolution,
        frame=config["frame"],
        exact_volume=switch("exact_volume", config["exact_volume"]),
        transport=switch("transport", config["transport"]),
        mesh=None if config["mesh"] is None else str(config["mesh"]),
        project=switch("project", config["project"]),
        seconds=positive("seconds", config["seconds"]),
        identity={"morph": _content(subject), "growth": config["growth"], "ends": config["ends"]},
    )
    chosen.export(request)


def _require_known(name: str | None) -> None:
    if name is not None and name not in FORMATS:
        near = get_close_matches(str(name), FORMATS, n=1)
        hint = f" (did you mean {near[0]}?)" if near else ""
        raise InputError(f"format={name} cannot be written: give one of {', '.join(FORMATS)}{hint}")


def _format(name: str | None, dim: int) -> Format:
    """The format of a name, or the first for the dimension."""
    fitting = {known: format for known, format in FORMATS.items() if dim in format.dims}
    if name is not None and name not in fitting:
        raise InputError(f"format={name} holds no curves, and this morph is 2D: give one of {', '.join(fitting)}")
    return fitting[name or next(iter(fitting))]


def _one(subjects: list[LoadedMorph]) -> LoadedMorph:
    if len(subjects) > 1:
        raise InputError(
            f"{len(subjects)} morphs are named, but one is exported at a time: repeat the command for each"
        )
    return subjects[0]


def _content(subject: LoadedMorph) -> str:
    """What a morph is: the hash of its checkpoint, or the name of a published one, whose files are checked."""
    file = Path(subject.origin)
    return file_sha256(file) if file.is_file() else subject.origin


if __name__ == "__main__":
    entry.run(main, "export")
