"""All frames in one file that plays."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import torch

from nsm.cli.errors import InputError
from nsm.cli.files import whole_file
from nsm.export.formats import Format, Request, one_file
from nsm.export.manifest import Manifest, write_records
from nsm.export.sequence import settings_of, summarize, surfaces_of, write_all, write_pair
from nsm.export.surfaces import CarriedAlong
from nsm.io.moving import playing_times
from nsm.morphs.surfaces import Frame
from nsm.shapes.textured import Attributes
from nsm.types import SimplexMesh

log = logging.getLogger(__name__)


class Animation(Format):
    """One file with all frames, and beside it ``….json`` that says what each is.

    Frames are kept in a hidden folder beside the file until it is written, so that an interrupted export can go on.

    Args:
        suffixes: of the file, with the dot; the first is the default.
        write_frames: writes surfaces, each of its own connectivity.
        write_carried: writes one surface that moves, with what its vertices have.
    """

    def __init__(
        self,
        suffixes: tuple[str, ...],
        write_frames: Callable[[Path, Iterable[Frame], float], None],
        write_carried: Callable[[Path, Iterable[Frame], float, Attributes], None],
    ) -> None:
        self.suffixes, self.write_frames, self.write_carried = suffixes, write_frames, write_carried

    def export(self, request: Request) -> Path:
        playing_times(request.times, request.seconds)  # before anything is made in vain
        path = one_file(request.output, self.suffixes)
        parts = path.parent / f".{path.name}.parts"
        surfaces = surfaces_of(request)
        manifest = _leftover(parts, settings_of(request, path.suffix))
        write_all(manifest, "npz", request, surfaces, _write_part)
        if isinstance(surfaces, CarriedAlong):
            self.write_carried(path, _read_parts(manifest), request.seconds, surfaces.attributes)
            write_pair(path.parent, surfaces.pair())
        else:
            self.write_frames(path, _read_parts(manifest), request.seconds)
        write_records(path.with_name(f"{path.name}.json"), manifest.settings, manifest.records)
        shutil.rmtree(parts)
        summarize(manifest, request)
        log.info("wrote %d frames to %s (%.1f MB)", len(request.times), path, path.stat().st_size / 1e6)
        return path


def _leftover(parts: Path, settings: dict[str, object]) -> Manifest:
    """What an interrupted export left, if it was the same."""
    try:
        return Manifest(parts, settings, "frame_*.npz")
    except InputError:
        log.info("an interrupted export of something else is thrown away: %s", parts)
        shutil.rmtree(parts)
        return Manifest(parts, settings, "frame_*.npz")


def _write_part(path: Path, frame: Frame, attributes: Attributes) -> None:
    with whole_file(path) as temporary:
        np.savez(
            temporary,
            vertices=frame.mesh.vertices.cpu().numpy(),
            simplices=frame.mesh.simplices.cpu().numpy(),
            normals=frame.normals.cpu().numpy(),
        )


def _read_parts(manifest: Manifest) -> Iterator[Frame]:
    """The frames in their order, one at a time in memory; of no triangles at a time without a surface."""
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
