"""Frames of an export, one file each, written so that an interrupted export can resume."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from pathlib import Path

from nsm.cli.errors import InputError
from nsm.cli.progress import Progress
from nsm.export.manifest import Manifest, Record, report
from nsm.export.request import Request
from nsm.export.surfaces import Surfaces
from nsm.geometry.topology import component_count, enclosed_volume
from nsm.morphs.surfaces import Frame
from nsm.shapes.download import file_sha256, resolve
from nsm.shapes.textured import Attributes

log = logging.getLogger(__name__)

#: Writes a frame with the attributes of its vertices.
WriteFrame = Callable[[Path, Frame, Attributes], None]


def write_frames(manifest: Manifest, suffix: str, request: Request, surfaces: Surfaces, write: WriteFrame) -> None:
    """Write the frames that are missing, with progress.

    Raises:
        InputError: If there is no surface at any time.
    """
    with Progress() as progress:
        surfaces.prepare(progress)
        progress.stage("exporting", len(request.times), len(manifest.records))
        for number, _ in enumerate(_records(manifest, suffix, request.times, surfaces, write), 1):
            progress.update(number)
    if all(record.file is None for record in manifest.records.values()):
        manifest.remove()
        raise InputError(
            f"The morph must have a surface at one of the {len(request.times)} times, got none. Try other `times`, or "
            "train it again."
        )


def settings_of(request: Request, suffix: str) -> dict[str, object]:
    """Collect the plain values that determine the frames."""
    return {
        **(request.identity or {}),
        "format": suffix,
        "times": request.times,
        "resolution": request.resolution,
        "coordinates": request.coordinates,
        "exact_volume": request.exact_volume,
        "advect": request.advect,
        "mesh": None if request.mesh is None else file_sha256(resolve(request.mesh)),
        "project": request.project if request.advect else None,
    }


def summarize(manifest: Manifest, request: Request) -> int:
    """Log the volumes of the frames, and return how many there are."""
    low, high = request.morph.bounds
    report(manifest.records, request.exact_volume, float((high - low).max()))
    return sum(record.file is not None for record in manifest.records.values())


def _records(
    manifest: Manifest, suffix: str, times: list[float], surfaces: Surfaces, write: WriteFrame
) -> Iterator[Record]:
    """Write the frames that are missing, each atomically, and yield the records of all.

    A time without a surface causes a warning, and there is no file of that number.
    """
    for number, time in enumerate(times):
        if number not in manifest.records:
            frame, name = surfaces(time), f"frame_{number:04d}.{suffix}"
            there = len(frame.mesh.simplices) > 0
            if there:
                manifest.save()  # first, so that an interrupted export recognizes its own first frame
                write(manifest.folder / name, frame, surfaces.attributes)
            else:
                log.warning("skipped %s: there is no surface at t = %g", name, time)
            volume, components = enclosed_volume(frame.mesh), component_count(frame.mesh)
            manifest.add(number, Record(time, frame.level, volume, components, name if there else None))
        yield manifest.records[number]
