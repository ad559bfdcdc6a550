"""PLY, OBJ, and STL: a mesh file per frame."""

from __future__ import annotations

import logging
from pathlib import Path

from nsm.cli.locks import only_writer_of_folder
from nsm.export.manifest import Manifest
from nsm.export.request import Format, Request
from nsm.export.sequence import settings_of, summarize, write_frames
from nsm.export.surfaces import surfaces_of
from nsm.io.mesh import write_mesh
from nsm.morphs.surfaces import Frame
from nsm.shapes.textured import Attributes

log = logging.getLogger(__name__)


class Meshes(Format):
    """Files ``frame_0000.ply``, ``frame_0001.ply``, …, and ``frames.json`` that describes them.

    Args:
        suffix: Suffix of the files, without the dot.
        dims: Dimensions of the morphs that the format can hold.
    """

    def __init__(self, suffix: str, dims: tuple[int, ...] = (3,)) -> None:
        self.suffix, self.dims = suffix, dims

    def export(self, request: Request) -> Path:
        with only_writer_of_folder(request.output):
            return self._export(request)

    def _export(self, request: Request) -> Path:
        surfaces = surfaces_of(request)
        manifest = Manifest(request.output, settings_of(request, self.suffix), f"frame_*.{self.suffix}")
        before = len(manifest.records)
        write_frames(manifest, self.suffix, request, surfaces, _write)
        surfaces.write_companions(request.output)
        written = summarize(manifest, request)
        resumed = f" ({before} existed)" if before else ""
        log.info("wrote %d of %d frames to %s%s", written, len(request.times), request.output, resumed)
        return request.output


def _write(path: Path, frame: Frame, attributes: Attributes) -> None:
    write_mesh(path, frame.mesh, frame.normals, attributes)
