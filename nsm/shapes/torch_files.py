"""Reading of files of torch that may be damaged, or written by somebody else."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nsm.cli.errors import InputError

#: Largest file that is read, in bytes. A checkpoint of two meshes of ten million triangles has 0.7e9.
MAX_BYTES = 4 * 2**30


def load_torch(file: Path, content: str, example: str) -> Any:
    """Read plain values and tensors without executing anything in the file.

    The archive that ``torch.save`` writes holds a checksum (CRC-32) of each of its parts, which ``torch.load`` does not
    compare; here a file with a single wrong bit is refused. All tensors that are returned are dense, in memory, and no
    larger than the file.

    Args:
        file: A file that ``torch.save`` wrote.
        content: What the file must be, for messages.
        example: What to try instead, for messages.

    Raises:
        InputError: If the file is too large, damaged, or holds anything but plain values and such tensors.
    """
    try:
        size = _require_sound(file)
        loaded = torch.load(file, map_location="cpu", weights_only=True)
        for tensor in tensors(loaded):
            _require_plain(tensor, size)
    except Exception as error:  # torch, pickle, and zipfile raise many types of exceptions for broken files
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(
            f"`{file}` must be {content}, got a file that cannot be read ({reason}). Try {example}."
        ) from error
    return loaded


def tensors(content: Any) -> Iterator[Tensor]:
    """All tensors in nested lists and dictionaries."""
    if isinstance(content, Tensor):
        yield content
    elif isinstance(content, Mapping):
        for key, value in content.items():
            yield from tensors(key)
            yield from tensors(value)
    elif isinstance(content, list | tuple | set):
        for value in content:
            yield from tensors(value)


def is_state_dict(content: Any) -> bool:
    """Whether a content consists of tensors by name."""
    return isinstance(content, dict) and all(isinstance(k, str) and isinstance(v, Tensor) for k, v in content.items())


def _require_sound(file: Path) -> int:
    """Compare the size and the checksums of an archive; returns the number of bytes of its content."""
    size = file.stat().st_size
    if zipfile.is_zipfile(file):
        with zipfile.ZipFile(file) as archive:
            parts = archive.infolist()
            size = sum(part.file_size for part in parts)
            # of a part that is marked as a folder, or has another size, torch returns memory that nothing was read into
            if odd := [p for p in parts if p.external_attr or p.compress_type or p.file_size != p.compress_size]:
                raise ValueError(f"the header of {odd[0].filename} is not as torch writes it, so the file is damaged")
            if size <= MAX_BYTES and (damaged := archive.testzip()) is not None:
                raise ValueError(f"the checksum of {damaged} is wrong, so the file is damaged")
    if size > MAX_BYTES:
        raise ValueError(f"its content has {size / 2**30:.3g} GiB, more than {MAX_BYTES / 2**30:g} GiB")
    return size


def _require_plain(tensor: Tensor, size: int) -> None:
    """Require a dense tensor of numbers in memory that is not larger than the file, such as by repeating one number."""
    if tensor.layout != torch.strided or tensor.device.type != "cpu" or tensor.is_quantized or tensor.is_complex():
        kind = f"{tensor.layout}, {tensor.device}, {tensor.dtype}"
        raise ValueError(f"a tensor is not a dense array of real numbers ({kind})")
    if tensor.numel() * tensor.element_size() > size:
        raise ValueError(f"a tensor of shape {tuple(tensor.shape)} is larger than the file")
