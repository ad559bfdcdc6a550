"""Checkpoints that describe themselves, and their safe loading.

A checkpoint is Lightning's, plus an entry ``nsm`` of plain values:

    format      int, raised whenever old files can no longer be read
    version     of nsm that wrote it
    model       how to build the networks: nested ``_target_`` configs, ω and end shapes included
    config      the resolved configuration of the run
    provenance  where the end shapes come from, and the scales that made their volumes equal

Loading needs nothing but the file. It is read by ``torch.load(weights_only=True)``, so no object in it can run
code, and a ``_target_`` may only name a network, field or shape class of this package.
"""

from __future__ import annotations

import importlib
import inspect
import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import nn

import nsm
from nsm.cli.errors import InputError
from nsm.shapes import MeshFile, Similarity, SirenFile, SirenShape
from nsm.shapes.similarity import Pose
from nsm.types import Morph

FORMAT = 1


def describe(model: Mapping[str, Any], config: Mapping[str, Any], provenance: Mapping[str, Any]) -> dict[str, Any]:
    """The entry that a checkpoint carries under ``nsm``; all arguments are plain nested values."""
    return {
        "format": FORMAT,
        "version": nsm.__version__,
        "model": dict(model),
        "config": dict(config),
        "provenance": dict(provenance),
    }


def load_morph(path: str | os.PathLike[str], device: str | torch.device = "cpu") -> Morph:
    """Load a morph for inference, of whatever method.

    Args:
        path: a checkpoint, or the folder of a run (its ``checkpoints/best.ckpt`` is taken then).
        device: where to put it.

    Returns:
        The morph, with frozen weights, ready to be called as ``morph(x, t)``.

    Raises:
        InputError: if there is no such file, or it is cut, of another format, or not a checkpoint of a morph.
    """
    file = find_checkpoint(path)
    content = read_checkpoint(file)
    morph = _load(
        content, file, "morph.", Morph, "a still shape, not a morph: give the checkpoint of a run with task=morph"
    )
    morph.provenance = content["nsm"].get("provenance", {})
    return morph.to(device).eval().requires_grad_(False)


def load_shape(path: str | os.PathLike[str], pose: Pose = None) -> SirenShape:
    """Load the network of a shape, fitted by a run with task=sdf, as a shape.

    Args:
        path: its checkpoint, or the folder of the run.
        pose: rotation, translation and scale given to the shape.

    Raises:
        InputError: as `load_morph` does.
    """
    file = find_checkpoint(path)
    shape = _load(
        read_checkpoint(file),
        file,
        "",
        SirenShape,
        "a morph, not a single shape: give the checkpoint of a run with task=sdf",
    )
    return shape.transformed(Similarity.read(pose, shape.dim))


def _load(content: Mapping[str, Any], file: Path, prefix: str, kind: type, other: str) -> Any:
    """Build the model that a checkpoint describes, and give it the weights stored under ``prefix``."""
    try:
        model = build(content["nsm"]["model"])
        fitting = isinstance(model, kind)
        if not fitting:
            raise InputError(f"{file} holds {other}")
        weights = content["state_dict"]
        model.load_state_dict({k.removeprefix(prefix): v for k, v in weights.items() if k.startswith(prefix)})
    except InputError:
        raise
    except (KeyError, TypeError, AttributeError, ValueError, RuntimeError) as error:
        raise InputError(
            f"{file} is damaged: its weights do not fit the model it describes ({_first_line(error)})"
        ) from error
    return model


def find_checkpoint(path: str | os.PathLike[str]) -> Path:
    """The checkpoint file that a path means: itself, or the best one (else the last) of a run's folder."""
    path = Path(path)
    if path.is_dir():
        found = [f for name in ("best", "last") if (f := path / "checkpoints" / f"{name}.ckpt").is_file()]
        if not found:
            raise InputError(
                f"{path} holds no checkpoints/best.ckpt: give a checkpoint, or the folder of a finished run"
            )
        return found[0]
    if not path.is_file():
        raise InputError(f"there is no checkpoint {path}: give the path of a .ckpt file or of a run's folder")
    return path


def read_checkpoint(file: Path) -> dict[str, Any]:
    """The content of a checkpoint of this package, nothing in it executed."""
    try:
        content = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:  # every kind of broken file fails in its own way inside torch and pickle
        raise InputError(
            f"{file} cannot be read as a checkpoint: it is cut, or not one, or holds more than weights "
            f"({_first_line(error)}); give a .ckpt file written by nsm"
        ) from error
    entry = content.get("nsm") if isinstance(content, dict) else None
    if not isinstance(entry, dict) or "state_dict" not in content:
        raise InputError(
            f"{file} is not a checkpoint of nsm: give a .ckpt file that a run wrote (official=… reads the authors')"
        )
    if entry.get("format") != FORMAT:
        raise InputError(
            f"{file} has checkpoint format {entry.get('format')} (written by nsm {entry.get('version')}), but this is "
            f"nsm {nsm.__version__}, which reads format {FORMAT}: load it with the version that wrote it, or train "
            "again"
        )
    return content


def build(node: Any) -> Any:
    """Instantiate nested ``_target_`` configs, of module classes of this package alone.

    Raises:
        InputError: if a target is anything else.
    """
    if isinstance(node, Mapping):
        arguments = {key: build(value) for key, value in node.items() if key not in ("_target_", "_partial_")}
        if "_target_" not in node:
            return arguments
        made = _module_class(node["_target_"])
        return partial(made, **arguments) if node.get("_partial_") else made(**arguments)
    if isinstance(node, list):
        return [build(value) for value in node]
    return node


def _module_class(target: Any) -> type[nn.Module]:
    module, _, name = str(target).rpartition(".")
    found: Any = None
    if module == "nsm" or module.startswith("nsm."):
        try:
            found = getattr(importlib.import_module(module), name, None)
        except ImportError:
            found = None
    ours = inspect.isclass(found) and issubclass(found, nn.Module) and found.__module__.startswith("nsm.")
    if not ours or issubclass(found, (MeshFile, SirenFile)):  # which would read, or download, another file
        raise InputError(
            f"a checkpoint names {target!r}, which is no network, field or shape of nsm: do not trust this file"
        )
    return found


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0][:200]
