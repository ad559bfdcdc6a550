"""ONNX: the fields as a model for onnxruntime and other runtimes.

References:
    https://onnx.ai
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

from nsm.cli.errors import InputError
from nsm.cli.extras import require
from nsm.cli.files import atomic_write
from nsm.export.network_format import DESCRIPTION, traced
from nsm.types import Morph


def write_onnx(path: Path | str, morph: Morph) -> None:
    """Write the fields as an ONNX model, with their description in its metadata under ``nsm.json``.

    Args:
        path: The file to write.
        morph: A morph of networks.

    Raises:
        InputError: If onnx or onnxscript is not installed, the morph is not made of networks, or the file cannot be
            written.
    """
    require("onnx", "onnxscript", extra="onnx", task="An ONNX file")
    networks = morph.networks()
    program, described = traced(networks), networks.description
    names = {"input_names": ["points", "time"], "output_names": described["outputs"]}
    try:
        with _quietly(), torch.no_grad():
            model = torch.onnx.export(program, dynamo=True, verbose=False, **names)
    except torch.onnx.OnnxExporterError as error:
        raise InputError(
            "`format=onnx` must be given a morph that ONNX has operations for, got one with others, such as a growth "
            "by a table. Try `format=pt2`."
        ) from error
    assert model is not None  # guaranteed by dynamo=True
    model.model.metadata_props[DESCRIPTION] = json.dumps(described)
    with atomic_write(path) as temporary:
        temporary.write_bytes(model.model_proto.SerializeToString())


@contextmanager
def _quietly() -> Iterator[None]:
    """Suppress messages of the exporter about packages and constants, which concern no user."""
    logs = [logging.getLogger(name) for name in ("torch.onnx", "onnx_ir", "onnxscript")]
    before = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        for log, level in zip(logs, before, strict=True):
            log.setLevel(level)
