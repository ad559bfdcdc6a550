"""The fields of a morph for programs that do not have nsm: weights with a description, and compiled programs.

Three formats, all in single precision and for any number of points:

    safetensors  the weights, and JSON that says what to do with them (docs/inference.md has a reader of 40 lines)
    pt2          a program of torch.export
    onnx         a program of ONNX, for onnxruntime and what else reads it

The programs take ``points`` (n, d) and ``time`` (n,), and give ``signed_distance`` (n,), its spatial ``gradient``
(n, d) and, where the morph has one, ``velocity`` (n, d).
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from safetensors.torch import save_file

from nsm.cli.errors import InputError
from nsm.cli.extras import require
from nsm.cli.files import whole_file
from nsm.types import Morph, Networks

#: Where the description stands in each file.
DESCRIPTION = "nsm.json"
#: Points on which a program is traced; any number but 0 and 1, which are taken as they are.
_TRACED_POINTS = 8


def write_safetensors(path: Path | str, morph: Morph) -> None:
    """Write the weights of f and V as safetensors, with their description as JSON in its metadata under ``nsm.json``.

    ``field.0.weight`` (out, in), ``field.0.bias`` (out,), … and ``velocity.0.weight``, … are those of the layers from
    the first to the last, ω folded in, in float32: h ↦ sin(W h + b), or another ``activation``, and W h + b at the end.

    Raises:
        InputError: if a part of the morph is no network of its own (a volume that changes, a velocity made of f), or
            the file cannot be written.
    """
    networks = morph.networks()
    if networks.weights is None:
        described = networks.description
        what = "a changing volume" if described["grown"] else f"the velocity {described['velocity']['kind']}"
        raise InputError(
            f"`format` must be pt2 or onnx for a morph with {what}, which is a formula without weights, got "
            "safetensors. Try `format=onnx`" + (" or `growth=none`." if described["grown"] else ".")
        )
    with whole_file(path) as temporary:
        save_file(networks.weights, temporary, metadata={DESCRIPTION: json.dumps(networks.description)})


def write_pt2(path: Path | str, morph: Morph) -> None:
    """Write the fields as a program of torch.export; their description is its extra file ``nsm.json``.

    Raises:
        InputError: if the morph is not made of networks, or the file cannot be written.
    """
    networks = morph.networks()
    program = _traced(networks)
    with whole_file(path) as temporary:
        torch.export.save(program, temporary, extra_files={DESCRIPTION: json.dumps(networks.description)})


def write_onnx(path: Path | str, morph: Morph) -> None:
    """Write the fields as an ONNX model; their description stands in its metadata under ``nsm.json``.

    Raises:
        InputError: if onnx or onnxscript is not installed, the morph is not made of networks, or the file cannot be
            written.
    """
    require("onnx", "onnxscript", extra="onnx", task="An ONNX file")
    networks = morph.networks()
    program, described = _traced(networks), networks.description
    names = {"input_names": ["points", "time"], "output_names": described["outputs"]}
    try:
        with _quietly(), torch.no_grad():
            made = torch.onnx.export(program, dynamo=True, verbose=False, **names)
    except torch.onnx.OnnxExporterError as error:
        raise InputError(
            "ONNX has no operation for a part of this morph (a growth by a table is such a part): give format=pt2"
        ) from error
    assert made is not None  # as it is with dynamo=True
    made.model.metadata_props[DESCRIPTION] = json.dumps(described)
    with whole_file(path) as temporary:
        made.save(temporary)


@torch.no_grad()
def _traced(networks: Networks) -> torch.export.ExportedProgram:
    """The fields as a graph of plain operations, for any number of points."""
    points, time = torch.rand(_TRACED_POINTS, networks.description["dim"]), torch.rand(_TRACED_POINTS)
    networks.program(points, time)  # fill the constant cache of the calculus before tracing captures fake tensors
    n = torch.export.Dim("n")
    program = torch.export.export(networks.program, (points, time), dynamic_shapes={"points": {0: n}, "time": {0: n}})
    for node in program.graph.nodes:
        node.meta.pop("stack_trace", None)  # paths of this machine
    return program


@contextmanager
def _quietly() -> Iterator[None]:
    """Keep back what the exporter says about packages and constants that nobody asked for."""
    logs = [logging.getLogger(name) for name in ("torch.onnx", "onnx_ir", "onnxscript")]
    before = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        for log, level in zip(logs, before, strict=True):
            log.setLevel(level)
