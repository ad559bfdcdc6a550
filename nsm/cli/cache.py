"""Folder of what is kept between commands: fitted networks and downloaded files."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nsm.cli.errors import InputError


def cache_folder() -> Path:
    """Folder that ``NSM_CACHE_DIR`` names if that is set, otherwise the one of the user; it may not exist yet."""
    if named := os.environ.get("NSM_CACHE_DIR"):
        return Path(named).expanduser()
    import pooch  # imported here because it is slow to import and rarely needed

    return Path(pooch.os_cache("nsm"))


@contextmanager
def writing_to_cache() -> Iterator[None]:
    """Blame the cache and its setting for an error of writing into it.

    Raises:
        InputError: If the block raises an error of the operating system, or one of `nsm.cli.files.atomic_write`.
    """
    try:
        yield
    except (OSError, InputError) as error:
        cause = error if isinstance(error, OSError) else error.__cause__
        if not isinstance(cause, OSError):
            raise
        raise InputError(
            f"`NSM_CACHE_DIR` must name a folder that can be written, got {cache_folder()}: {cause.strerror}. Try "
            "`export NSM_CACHE_DIR=FOLDER`, or to free space there."
        ) from error


def require_writable_cache() -> None:
    """Require that the cache can be written, before long work whose result it keeps.

    Raises:
        InputError: If it cannot.
    """
    with writing_to_cache():
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(folder))
