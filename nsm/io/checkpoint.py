"""Self-describing checkpoints: the only writer and reader of their format.

A checkpoint is a dictionary as Lightning writes it, with the weights under ``state_dict`` and, under ``nsm``, an entry
of plain values:

    format      Version of this format, an integer that is raised whenever old files can no longer be read.
    version     Version of nsm that wrote the file.
    model       Nested ``_target_`` configs of the networks, including ω and the end shapes.
    config      The resolved configuration of the run.
    provenance  Where the end shapes come from, with the factors that made their volumes equal, and their landmarks.

Loading needs nothing but the file. It is read with ``torch.load(weights_only=True)``, so that no object in it can run
code, and `nsm.io.build` accepts classes of this package only.
"""

from __future__ import annotations

import io
import logging
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

import nsm
from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.io.build import build
from nsm.io.soundness import require_size, require_working
from nsm.shapes import Similarity, SirenShape
from nsm.shapes.similarity import Pose
from nsm.shapes.torch_files import is_state_dict, load_torch
from nsm.types import Morph

log = logging.getLogger(__name__)

FORMAT = 2
#: Key of the entry in the dictionary of a checkpoint.
ENTRY = "nsm"
#: Prefix of a morph's weights, after the attribute of the training task that holds it. Those of a shape have none.
_MORPH_PREFIX = "morph."


class Checkpoint(NamedTuple):
    """A checkpoint that was read: its file, and the dictionary in it."""

    file: Path
    content: dict[str, Any]


def describe(
    model: Mapping[str, Any], config: Mapping[str, Any] | None = None, provenance: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Make the entry that a checkpoint holds under `ENTRY`.

    Args:
        model: Nested ``_target_`` configs of plain values, from which `nsm.io.build.build` makes the networks.
        config: Resolved configuration of the run.
        provenance: Where the end shapes come from (`nsm.types.Morph`).
    """
    return {
        "format": FORMAT,
        "version": nsm.__version__,
        "model": dict(model),
        "config": dict(config or {}),
        "provenance": dict(provenance or {}),
    }


def write_checkpoint(path: Path, entry: Mapping[str, Any], state_dict: Mapping[str, Tensor]) -> None:
    """Write a checkpoint that nothing but loading needs, without the state of an optimizer.

    Args:
        path: File to write.
        entry: What `describe` returns.
        state_dict: Weights by name.

    Raises:
        InputError: If the file cannot be written.
    """
    write_content(path, {ENTRY: dict(entry), "state_dict": dict(state_dict)})


def write_content(path: Path, content: Mapping[str, Any]) -> None:
    """Write what `read_checkpoint` returns, whole or not at all.

    Args:
        path: File to write.
        content: The dictionary of a checkpoint.

    Raises:
        InputError: If the file cannot be written.
    """
    data = io.BytesIO()
    torch.save(dict(content), data)  # into memory, since torch reports a full disk as an error of its own
    with atomic_write(path) as temporary:
        temporary.write_bytes(data.getbuffer())


def save_morph(path: Path, morph: nn.Module, entry: Mapping[str, Any]) -> None:
    """Write a checkpoint that `load_morph` reads.

    Args:
        path: File to write.
        morph: Module whose weights are saved.
        entry: Its description, see `describe`.
    """
    write_checkpoint(path, entry, {f"{_MORPH_PREFIX}{name}": value for name, value in morph.state_dict().items()})


def save_shape(path: Path, shape: SirenShape) -> None:
    """Write a checkpoint that `load_shape` reads."""
    write_checkpoint(path, describe(shape.config()), shape.state_dict())


def load_morph(path: str | os.PathLike[str], device: str | torch.device = "cpu") -> Morph:
    """Load a morph for inference.

    Args:
        path: Checkpoint, or folder of a run, whose ``checkpoints/best.ckpt`` is read.
        device: Device on which the morph is evaluated.

    Returns:
        The morph of any method, with frozen weights, to be called as ``morph(x, t)``.

    Raises:
        InputError: If there is no such file, or it is incomplete, of another format, or not a checkpoint of a morph.
    """
    return restore_morph(open_checkpoint(path), device)


def restore_morph(checkpoint: Checkpoint, device: str | torch.device = "cpu") -> Morph:
    """Make the morph of a checkpoint that was read, as `load_morph` does."""
    morph = _restore(checkpoint, Morph, _MORPH_PREFIX, "morph")
    morph.provenance = checkpoint.content[ENTRY].get("provenance", {})
    restored: Morph = morph.to(device).eval().requires_grad_(False)
    return restored


def load_shape(path: str | os.PathLike[str], pose: Pose = None) -> SirenShape:
    """Load the network of a shape that a run with ``task=sdf`` fitted.

    Args:
        path: Checkpoint, or folder of the run.
        pose: Rotation, translation, and scale applied to the shape.

    Raises:
        InputError: If there is no such file, or it is incomplete, of another format, or not a checkpoint of a shape.
    """
    shape = _restore(open_checkpoint(path), SirenShape, "", "sdf")
    return shape.transformed(Similarity.read(pose, shape.dim))


def find_checkpoint(path: str | os.PathLike[str]) -> Path:
    """Find the file of a checkpoint.

    Args:
        path: Checkpoint, or folder of a run.

    Returns:
        The checkpoint itself, or the best one of the run, or its last one if there is no best one that can be read.

    Raises:
        InputError: If there is no such file, or the folder holds only checkpoints that cannot be read.
    """
    path = Path(path)
    return _of_run(path).file if path.is_dir() else _existing(path)


def open_checkpoint(path: str | os.PathLike[str]) -> Checkpoint:
    """Read the checkpoint that `find_checkpoint` finds.

    Raises:
        InputError: If there is no such file, or it cannot be read.
    """
    path = Path(path)
    return _of_run(path) if path.is_dir() else Checkpoint(_existing(path), read_checkpoint(path))


def _of_run(folder: Path) -> Checkpoint:
    found = readable_checkpoint(folder / "checkpoints", ("best", "last"))
    if found is None:
        raise InputError(
            f"`checkpoint` must be a checkpoint or the folder of a run, got {folder}, which has no "
            "checkpoints/best.ckpt. Try the folder of a finished run."
        )
    return found


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise InputError(
            f"`checkpoint` must be an existing file or folder, got {path}. Try the folder of a run, such as "
            "`checkpoint=outputs/demo`."
        )
    return path


def readable_checkpoint(folder: Path, names: Sequence[str]) -> Checkpoint | None:
    """Read the first checkpoint of a run that can be read; a warning names those that cannot.

    Args:
        folder: Folder of the checkpoints.
        names: Names without the suffix, the preferred one first.

    Returns:
        The checkpoint, or None if there is none.

    Raises:
        InputError: If there are some, and none of them can be read.
    """
    unreadable: InputError | None = None
    for file in (folder / f"{name}.ckpt" for name in names):
        if not file.is_file():
            continue
        try:
            content = read_checkpoint(file)
        except InputError as error:
            unreadable = unreadable or error
            continue
        if unreadable is not None:
            log.warning("%s.ckpt in %s cannot be read, so %s is used", names[0], folder, file.name)
        return Checkpoint(file, content)
    if unreadable is not None:
        raise unreadable
    return None


def read_checkpoint(file: Path) -> dict[str, Any]:
    """Read the content of a checkpoint without executing anything in it.

    Raises:
        InputError: If the file is incomplete, not a checkpoint of nsm, or of another format.
    """
    content = load_torch(file, "a complete checkpoint of weights and plain values", "a .ckpt file that nsm wrote")
    entry = content.get(ENTRY) if isinstance(content, dict) else None
    if not isinstance(entry, dict) or "state_dict" not in content:
        raise InputError(
            f"`{file}` must be a checkpoint of nsm, got another file of torch. Try a .ckpt file that a run wrote, or "
            "`official=` for the authors' morphs."
        )
    if entry.get("format") != FORMAT:
        raise InputError(
            f"`{file}` must have checkpoint format {FORMAT} for nsm {nsm.__version__}, got format "
            f"{entry.get('format')}. Try nsm {entry.get('version')}, which wrote it, or train again."
        )
    weights = content["state_dict"]
    if not is_state_dict(weights):
        raise InputError(f"`{file}` must hold weights by name, got something else. Try a .ckpt file that a run wrote.")
    if broken := [name for name, value in weights.items() if not bool(value.isfinite().all())]:
        raise InputError(
            f"`{file}` must hold finite weights, got {broken[0]} with numbers that are not. Try an earlier "
            "checkpoint of the run."
        )
    _require_provenance(file, entry.get("provenance", {}))
    return content


def _require_provenance(file: Path, provenance: Any) -> None:
    """Require what is read of the provenance of the end shapes: groups of values, and positive scales."""
    ends = [provenance.get(end, {}) for end in ("source", "target")] if isinstance(provenance, dict) else [None]
    for end in ends:
        scale = end.get("scale", 1.0) if isinstance(end, dict) else 0.0
        if not isinstance(scale, int | float) or not 0 < scale < math.inf:
            raise InputError(
                f"`{file}` must say where its shapes come from, got {str(provenance)[:80]}. Try a .ckpt file "
                "that a run wrote."
            )


def _restore(checkpoint: Checkpoint, kind: type[Any], prefix: str, task: str) -> Any:
    """Build the model that a checkpoint describes, and load the weights stored under a prefix.

    Args:
        checkpoint: The checkpoint.
        kind: Class of which the model must be.
        prefix: Beginning of the names of its weights.
        task: Task whose runs write such checkpoints.
    """
    file, content = checkpoint
    weights = content["state_dict"]
    try:
        described = content[ENTRY].get("model")
        require_size(described, weights)
        model: Any = build(described)
        if not isinstance(model, kind):
            raise InputError(
                f"it must be the checkpoint of a run with `task={task}`, got a {type(model).__name__}. Try another run."
            )
        model.load_state_dict({k.removeprefix(prefix): v for k, v in weights.items() if k.startswith(prefix)})
        require_working(model)
    except InputError as error:
        raise InputError(f"`{file}` cannot be loaded: {error}") from error
    except Exception as error:  # classes that get arguments from a stranger raise many types of exceptions
        raise InputError(
            f"`{file}` must hold weights that fit its model, got others ({_first_line(error)}). Try another checkpoint "
            "of the run."
        ) from error
    return model


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0][:200]
