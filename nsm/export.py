"""``python -m nsm.export``: a morph as files for other programs."""

from __future__ import annotations

from difflib import get_close_matches
from math import inf
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf

from nsm import entry
from nsm.errors import InputError
from nsm.exporters import Animation, Format, Meshes, Program, Request
from nsm.inference import write_onnx, write_pt2, write_safetensors
from nsm.metrics import even_times
from nsm.shapes.download import file_sha256
from nsm.subjects import Subject, load_subjects, whole_number
from nsm.writers import gltf, usd

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
    times, resolution = _times(config["times"]), whole_number("resolution", config["resolution"], 2)
    if config["threads"] is not None:
        torch.set_num_threads(whole_number("threads", config["threads"], 1))
    _require_known(config["format"])
    subject = _one(load_subjects(config, "nsm.export"))
    request = Request(
        morph=subject.morph,
        output=Path(config["output"]) if config["output"] else _default_folder(subject),
        times=times,
        resolution=resolution,
        frame=config["frame"],
        exact_volume=_switch("exact_volume", config["exact_volume"]),
        transport=_switch("transport", config["transport"]),
        mesh=None if config["mesh"] is None else str(config["mesh"]),
        project=_switch("project", config["project"]),
        seconds=_duration(config["seconds"]),
        identity={"morph": _content(subject), "growth": config["growth"]},
    )
    _format(config["format"], subject.morph.dim).export(request)


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


def _one(subjects: list[Subject]) -> Subject:
    if len(subjects) > 1:
        raise InputError(
            f"{len(subjects)} morphs are named, but one is exported at a time: repeat the command for each"
        )
    return subjects[0]


def _content(subject: Subject) -> str:
    """What a morph is: the hash of its checkpoint, or the name of a published one, whose files are checked."""
    file = Path(subject.origin)
    return file_sha256(file) if file.is_file() else subject.origin


def _times(given: Any) -> list[float]:
    """Times from a count or a list."""
    if isinstance(given, int) and not isinstance(given, bool) and given >= 1:
        return even_times(given).tolist()
    numbers = given if isinstance(given, list) else []
    if numbers and all(isinstance(t, (int, float)) and not isinstance(t, bool) and 0 <= t <= 1 for t in numbers):
        return [float(t) for t in numbers]
    raise InputError(
        f"times={given} names no times: give how many, such as times=24, or a list of numbers from 0 to 1 such as "
        "times=[0,0.5,1]"
    )


def _switch(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"{name}={value} is neither yes nor no: give {name}=true or {name}=false")
    return value


def _duration(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < inf:
        raise InputError(f"seconds={value} is no time to play in: give a positive number, such as seconds=4")
    return float(value)


def _default_folder(subject: Subject) -> Path:
    if subject.folder is not None:
        return subject.folder / "export"
    return Path("outputs") / "exports" / Path(subject.origin).name


if __name__ == "__main__":
    entry.run(main, "export")
