"""GLB: one animated binary glTF file, which browsers and modeling programs play."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from nsm.export.animation import Animation
from nsm.export.request import Request
from nsm.io.gltf import write_glb_advected, write_glb_frames
from nsm.morphs.surfaces import Frame
from nsm.shapes.textured import Attributes


class GlbAnimation(Animation):
    """One mesh with morph targets and colors, or with ``advect=false`` a mesh per time."""

    suffixes = (".glb",)
    advects = True

    def write_extracted(self, path: Path, frames: Iterable[Frame], request: Request) -> None:
        write_glb_frames(path, frames, request.seconds)

    def write_advected(self, path: Path, frames: Iterable[Frame], request: Request, attributes: Attributes) -> None:
        write_glb_advected(path, frames, request.seconds, attributes)
