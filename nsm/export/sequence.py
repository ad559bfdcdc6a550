"""A file a frame."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from nsm.cli.errors import InputError
from nsm.cli.files import whole_file
from nsm.export.formats import Format, Request, progress_bar
from nsm.export.manifest import Manifest, Record, report
from nsm.export.surfaces import CarriedAlong, Extracted, Pair, Surfaces
from nsm.geometry.topology import component_count, enclosed_volume
from nsm.io.mesh import write_mesh
from nsm.morphs.surfaces import Frame
from nsm.shapes.download import file_sha256, resolve
from nsm.shapes.textured import Attributes

log = logging.getLogger(__name__)

#: Writes a frame with what its vertices have.
WriteFrame = Callable[[Path, Frame, Attributes], None]


class Meshes(Format):
    """``frame_0000.ply``, ``frame_0001.ply``, …, and ``frames.json`` that says what each is.

    Args:
        suffix: of the files, without the dot.
        dims: dimensions of the morphs that the format can hold.
    """

    def __init__(self, suffix: str, dims: tuple[int, ...] = (3,)) -> None:
        self.suffix, self.dims = suffix, dims

    def export(self, request: Request) -> Path:
        surfaces = surfaces_of(request)
        manifest = Manifest(request.output, settings_of(request, self.suffix), f"frame_*.{self.suffix}")
        before = len(manifest.records)
        write_all(manifest, self.suffix, request, surfaces, _write)
        if isinstance(surfaces, CarriedAlong):
            write_pair(request.output, surfaces.pair())
        written = summarize(manifest, request)
        there = f" ({before} were there)" if before else ""
        log.info("wrote %d of %d frames to %s%s", written, len(request.times), request.output, there)
        return request.output


def write_all(manifest: Manifest, suffix: str, request: Request, surfaces: Surfaces, write: WriteFrame) -> None:
    """Write the frames that are not there yet, with progress.

    Raises:
        InputError: if there is no surface at any time.
    """
    with progress_bar() as bar:
        if isinstance(surfaces, CarriedAlong):
            carrying = bar.add_task("carrying", total=None)
            surfaces.progress = lambda done, total: bar.update(carrying, completed=done, total=total)
        records = write_sequence(manifest, suffix, request.times, surfaces, write)
        for _ in bar.track(records, len(request.times), description="exporting"):
            pass
    if all(record.file is None for record in manifest.records.values()):
        manifest.remove()
        raise InputError(
            f"this morph has no surface at any of the {len(request.times)} times, so nothing is written: train it again"
        )


def write_sequence(
    manifest: Manifest, suffix: str, times: list[float], surfaces: Surfaces, write: WriteFrame
) -> Iterator[Record]:
    """Write the frames that are not there yet, and yield the record of each, those of old ones too.

    Each file appears whole or not at all. At a time without a surface there is a warning, and no file of that number.
    """
    for number, time in enumerate(times):
        if number not in manifest.records:
            frame, name = surfaces(time), f"frame_{number:04d}.{suffix}"
            there = len(frame.mesh.simplices) > 0
            if there:
                manifest.save()  # or the first frame would be a stranger if it were the last
                write(manifest.folder / name, frame, surfaces.attributes)
            else:
                log.warning("there is no surface at t = %g: %s is left out", time, name)
            volume, parts = enclosed_volume(frame.mesh), component_count(frame.mesh)
            manifest.add(number, Record(time, frame.level, volume, parts, name if there else None))
        yield manifest.records[number]


def surfaces_of(request: Request) -> Surfaces:
    """Where the frames of a request come from."""
    return CarriedAlong(request) if request.transport else Extracted(request)


def settings_of(request: Request, suffix: str) -> dict[str, object]:
    """What decides the frames, as plain values."""
    return {
        **(request.identity or {}),
        "format": suffix,
        "times": request.times,
        "resolution": request.resolution,
        "frame": request.frame,
        "exact_volume": request.exact_volume,
        "transport": request.transport,
        "mesh": None if request.mesh is None else file_sha256(resolve(request.mesh)),
        "project": request.project if request.transport else None,
    }


def summarize(manifest: Manifest, request: Request) -> int:
    """Log what the frames are, and return how many there are."""
    low, high = request.morph.bounds
    report(manifest.records, request.exact_volume, float((high - low).max()))
    return sum(record.file is not None for record in manifest.records.values())


def write_pair(folder: Path, pair: Pair) -> None:
    """Write which point of the target each vertex of the source became: as numbers, and as two colored meshes."""
    suffix = "ply" if pair.source.vertices.shape[1] == 3 else "obj"
    for name, mesh in (("source", pair.source), ("target", pair.target)):
        write_mesh(folder / f"{name}.{suffix}", mesh, attributes=Attributes(colors=pair.colors))
    with whole_file(folder / "correspondences.npz") as temporary:
        np.savez_compressed(
            temporary,
            source_points=pair.source.vertices.cpu().numpy(),
            target_points=pair.target.vertices.cpu().numpy(),
            distances=pair.distances.cpu().numpy(),
            simplices=pair.source.simplices.cpu().numpy(),
        )
    log.info(
        "wrote correspondences.npz, source.%s and target.%s to %s (carried vertices missed the target by %.2g in the "
        "mean, %.2g at most)",
        suffix,
        suffix,
        folder,
        float(pair.distances.mean()),
        float(pair.distances.max()),
    )


def _write(path: Path, frame: Frame, attributes: Attributes) -> None:
    write_mesh(path, frame.mesh, frame.normals, attributes)
