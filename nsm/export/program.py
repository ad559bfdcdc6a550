"""The fields of a morph in one file, for inference elsewhere."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from nsm.cli.errors import InputError
from nsm.export.formats import Format, Request, one_file
from nsm.types import Morph

log = logging.getLogger(__name__)


class Program(Format):
    """f, ∇f and V, at every place and time.

    Args:
        name: of the format, which is also the suffix.
        write: one of `nsm.export.networks`.
    """

    dims = (2, 3)

    def __init__(self, name: str, write: Callable[[Path, Morph], None]) -> None:
        self.name, self.write = name, write

    def export(self, request: Request) -> Path:
        for name, asked in (("exact_volume", request.exact_volume), ("transport", request.transport)):
            if asked:
                raise InputError(
                    f"format={self.name} holds the fields, and {name}=true is about surfaces: leave it out, or give "
                    "format=ply, glb or usd"
                )
        if request.frame != "morph":
            raise InputError(
                f"format={self.name} holds the fields in the coordinates of the morph, and frame={request.frame} asks "
                "for others: leave it out"
            )
        path = one_file(request.output, (f".{self.name}",))
        self.write(path, request.morph)
        log.info("wrote the fields to %s (%.1f MB)", path, path.stat().st_size / 1e6)
        return path
