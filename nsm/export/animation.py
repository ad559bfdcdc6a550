"""Animations: all frames in one file that plays."""

from __future__ import annotations

import io
import logging
import shutil
from abc import abstractmethod
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import torch

from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.cli.locks import only_writer_of_file
from nsm.export.manifest import Manifest, write_records
from nsm.export.request import Format, Request, one_file
from nsm.export.sequence import settings_of, summarize, write_frames
from nsm.export.surfaces import surfaces_of
from nsm.io.moving import playing_times
from nsm.morphs.surfaces import Frame
from nsm.shapes.textured import Attributes
from nsm.types import SimplexMesh

log = logging.getLogger(__name__)


class Animation(Format):
    """One file with all frames, and beside it a JSON file of the same name that describes them.

    Frames are kept in a hidden folder beside the file until it is complete, so that an interrupted export can resume.
    """

    # all frames are in one file, and advecting a vertex takes the same time in each: both grow fourfold with twice this
    resolution = 128

    @abstractmethod
    def write_extracted(self, path: Path, frames: Iterable[Frame], request: Request) -> None:
        """Write the requested surfaces, of any connectivity, each visible around its own time."""

    @abstractmethod
    def write_advected(self, path: Path, frames: Iterable[Frame], request: Request, attributes: Attributes) -> None:
        """Write one mesh whose vertices move, with the attributes of its vertices."""

    def export(self, request: Request) -> Path:
        playing_times(request.times, request.seconds)  # fails before frames are computed in vain
        path = one_file(request.output, self.suffixes)
        with only_writer_of_file(path):
            self._export(request, path)
        log.info("wrote %d frames to %s (%.1f MB)", len(request.times), path, path.stat().st_size / 1e6)
        return path

    def _export(self, request: Request, path: Path) -> None:
        parts = path.parent / f".{path.name}.parts"
        surfaces = surfaces_of(request)
        manifest = _resumed(parts, settings_of(request, path.suffix))
        write_frames(manifest, "npz", request, surfaces, _write_part)
        if request.advect:
            self.write_advected(path, _read_parts(manifest), request, surfaces.attributes)
        else:
            self.write_extracted(path, _read_parts(manifest), request)
        surfaces.write_companions(path.parent)
        write_records(path.with_name(f"{path.name}.json"), manifest.settings, manifest.records)
        shutil.rmtree(parts)
        summarize(manifest, request)


def _resumed(parts: Path, settings: dict[str, object]) -> Manifest:
    """The frames that an interrupted export with the same settings has left; those of another are discarded."""
    try:
        return Manifest(parts, settings, "frame_*.npz")
    except InputError:
        log.info("discarding an interrupted export with other settings: %s", parts)
        shutil.rmtree(parts)
        return Manifest(parts, settings, "frame_*.npz")


def _write_part(path: Path, frame: Frame, attributes: Attributes) -> None:
    data = io.BytesIO()
    np.savez(
        data,
        vertices=frame.mesh.vertices.cpu().numpy(),
        simplices=frame.mesh.simplices.cpu().numpy(),
        normals=frame.normals.cpu().numpy(),
    )
    with atomic_write(path) as temporary:
        temporary.write_bytes(data.getbuffer())


def _read_parts(manifest: Manifest) -> Iterator[Frame]:
    """Read the frames in order, one at a time in memory; those without a surface have no triangles."""
    for number in sorted(manifest.records):
        record = manifest.records[number]
        if record.file is None:
            empty = torch.zeros(0, 3, dtype=torch.float64)
            yield Frame(record.time, record.level, SimplexMesh(empty, torch.zeros(0, 3, dtype=torch.long)), empty)
            continue
        with np.load(manifest.folder / record.file, allow_pickle=False) as part:
            arrays = {name: torch.from_numpy(part[name]) for name in ("vertices", "simplices", "normals")}
        mesh = SimplexMesh(arrays["vertices"], arrays["simplices"])
        yield Frame(record.time, record.level, mesh, arrays["normals"])
