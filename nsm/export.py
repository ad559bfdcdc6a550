"""``python -m nsm.export``: a morph as a sequence of meshes."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import Progress

from nsm import entry
from nsm.errors import InputError
from nsm.frames import extract_frame
from nsm.metrics import even_times
from nsm.morph import NeuralMorph
from nsm.shapes import Similarity
from nsm.subjects import Subject, load_subjects, whole_number
from nsm.types import SimplexMesh
from nsm.writers import write_mesh

log = logging.getLogger(__name__)

#: What can be written, by dimension; the first is the default.
FORMATS = {2: ("obj",), 3: ("ply", "obj", "stl")}
#: Whose coordinates the vertices may have.
FRAMES = ("morph", "source", "target")


def main(cfg: DictConfig) -> None:
    """Load one morph and write its surface at all times."""
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    times, resolution = _times(config["times"]), whole_number("resolution", config["resolution"], 2)
    if config["frame"] not in FRAMES:
        raise InputError(f"frame={config['frame']} is not known: give one of {', '.join(FRAMES)}")
    if config["format"] not in (None, *FORMATS[3]):
        raise InputError(f"format={config['format']} cannot be written: give one of {', '.join(FORMATS[3])}")
    if config["threads"] is not None:
        torch.set_num_threads(whole_number("threads", config["threads"], 1))
    subjects = load_subjects(config["checkpoint"], config["official"], "nsm.export")
    if len(subjects) > 1:
        raise InputError(
            f"{len(subjects)} morphs are named, but one is exported at a time: repeat the command for each"
        )
    morph = subjects[0].morph
    suffix = config["format"] or FORMATS[morph.dim][0]
    if suffix not in FORMATS[morph.dim]:
        raise InputError(f"format={suffix} holds no curves, and this morph is 2D: give format=obj")
    folder = Path(config["output"]) if config["output"] else _default_folder(subjects[0])

    written = 0
    with Progress(console=Console(stderr=True)) as bar:
        for _ in bar.track(
            export_frames(morph, folder, times, resolution, suffix, config["frame"]),
            len(times),
            description="exporting",
        ):
            written += 1
    if not written:
        raise InputError(
            f"{subjects[0].origin} has no surface at any of the {len(times)} times, so nothing is written: "
            "train it again"
        )
    log.info("wrote %d of %d frames to %s", written, len(times), folder)


def export_frames(
    morph: NeuralMorph, folder: Path, times: Sequence[float], resolution: int, suffix: str = "ply", frame: str = "morph"
) -> Iterator[Path]:
    """Write the surface at each time as ``frame_0000.ply``, ``frame_0001.ply``, … with the normals ∇f/‖∇f‖.

    Each file appears whole or not at all. At a time without a surface there is a warning, and no file of that number.

    Args:
        morph: the morph.
        folder: where the files go.
        times: one a frame.
        resolution: cells along the longest edge of the box.
        suffix: of `FORMATS`.
        frame: the vertices' coordinates: ``morph`` for those of the box; ``source`` or ``target`` for those of that
            end's file (or formula), so that fit, pose and normalisation of its volume are undone.

    Yields:
        Each file when it is written.

    Raises:
        InputError: if the folder holds frames of a longer sequence, or cannot be written.
    """
    back = Similarity.identity(morph.dim) if frame == "morph" else getattr(morph, frame).similarity.inverse()
    files = [folder / f"frame_{number:04d}.{suffix}" for number in range(len(times))]
    if strangers := sorted(set(folder.glob(f"frame_*.{suffix}")) - set(files)):
        raise InputError(
            f"{folder} holds frames of a longer sequence ({strangers[0].name} …), which would be taken for this one's: "
            "remove them, or give another output"
        )
    for time, file in zip(times, files, strict=True):
        _, _, mesh, normals = extract_frame(morph, time, resolution)
        if not len(mesh.simplices):
            file.unlink(missing_ok=True)
            log.warning("there is no surface at t = %g: %s is left out", time, file.name)
            continue
        # in double precision, for the coordinates of a file may lie far from its origin
        placed = SimplexMesh(back.apply(mesh.vertices.double()), mesh.simplices)
        write_mesh(file, placed, back.turn(normals.double()))
        yield file


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


def _default_folder(subject: Subject) -> Path:
    if subject.folder is not None:
        return subject.folder / "export"
    return Path("outputs") / "exports" / Path(subject.origin).name


if __name__ == "__main__":
    entry.run(main, "export")
