"""Formats that hold the networks of a morph in one file, for inference without nsm."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import torch

from nsm.cli.errors import InputError
from nsm.cli.locks import only_writer_of_file
from nsm.export.request import Format, Request, one_file, refuse_surface_settings
from nsm.types import Morph, Networks

log = logging.getLogger(__name__)

#: Name of the description of the morph in each file.
DESCRIPTION = "nsm.json"
#: Number of points for tracing; 0 and 1 would be taken as constants.
_TRACED_POINTS = 8


class NetworkFormat(Format):
    """f, ∇f, and V at any point and time, in single precision.

    Programs take ``points`` (n, d) and ``time`` (n,), and return ``signed_distance`` (n,), its spatial ``gradient``
    (n, d), and ``velocity`` (n, d) if the morph has one. docs/inference.md shows how to read each format.

    Args:
        name: Name of the format, which is also the suffix of its files.
        write: Writes the fields of a morph.
    """

    dims = (2, 3)
    holds_networks = True

    def __init__(self, name: str, write: Callable[[Path, Morph], None]) -> None:
        self.name, self.write, self.suffixes = name, write, (f".{name}",)

    def export(self, request: Request) -> Path:
        refuse_surface_settings(request, self.name, "the fields")
        if request.coordinates != "morph":
            raise InputError(
                f"`coordinates` must be morph for `format={self.name}`, which holds the fields, got "
                f"{request.coordinates}. Try `coordinates=morph`."
            )
        path = one_file(request.output, self.suffixes)
        with only_writer_of_file(path):
            self.write(path, request.morph)
        log.info("wrote the fields to %s (%.1f MB)", path, path.stat().st_size / 1e6)
        return path


@torch.no_grad()
def traced(networks: Networks) -> torch.export.ExportedProgram:
    """Trace f, ∇f, and V into a graph of plain operations, for any number of points."""
    points, time = torch.rand(_TRACED_POINTS, networks.description["dim"]), torch.rand(_TRACED_POINTS)
    networks.program(points, time)  # fills the constant cache of the calculus, which tracing would fill with fakes
    n = torch.export.Dim("n")
    program = torch.export.export(networks.program, (points, time), dynamic_shapes={"points": {0: n}, "time": {0: n}})
    for node in program.graph.nodes:
        node.meta.pop("stack_trace", None)  # contains paths of this machine
    return program
