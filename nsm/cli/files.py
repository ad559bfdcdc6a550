"""Atomic writing of files: a file appears completely or not at all."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from nsm.cli.errors import InputError
from nsm.cli.locks import scratch_folder

#: Numbers of the errors of a disk that is full, read-only, or broken, or of a file that is larger than allowed.
DISK_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO})


@contextmanager
def atomic_write(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside ``path``, which is renamed to ``path`` when the block succeeds.

    A missing folder is created. If the block raises, the temporary file is removed and an older file stays; if the
    process is killed, the next one that writes into the folder removes it. The content is on the disk before the file
    is renamed.

    Raises:
        InputError: If the folder cannot be created or written, ``path`` is a folder, or the disk is full.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"`{path}` must be the name of a file, got a folder. Try `{path / 'NAME'}`.")
    with ExitStack() as stack:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary = stack.enter_context(scratch_folder(path.parent)) / path.name
        except OSError as error:
            raise InputError(
                f"`{path}` must be writable, got: {error.strerror}. Try a path in another folder."
            ) from error
        with within_disk(path):
            temporary.touch()  # with the usual permissions
            yield temporary
            _sync(temporary)
            temporary.replace(path)
    with suppress(OSError):  # not every system can do that with a folder
        _sync(path.parent)


@contextmanager
def within_disk(path: Path | str) -> Iterator[None]:
    """Turn the error of a disk that is full, read-only, or broken into a sentence about a file.

    Raises:
        InputError: If the block raises such an error.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in DISK_ERRORS:
            raise
        raise InputError(
            f"`{path}` must fit on its disk, got: {error.strerror}. Try to free space there, or another folder."
        ) from error


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
