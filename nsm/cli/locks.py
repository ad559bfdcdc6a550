"""Locks: one command at a time writes into a folder or a file, and what a killed command left behind is removed.

All names begin with ``.nsm-`` and lie beside what they protect. The operating system releases a lock when its process
ends in any way, so a lock that can be taken belongs to no living process.
"""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import BaseFileLock, FileLock, Timeout

from nsm.cli.errors import InputError

#: Beginning of the names of locks and of scratch folders.
_PREFIX = ".nsm-"
_LOCK_SUFFIX = ".lock"
#: Patterns of the folders in a folder to which a command writes.
_LEVELS = ("", "*/", "*/*/")
#: Lock in a scratch folder.
_OWNER = "owner.lock"
#: Seconds for which a command waits for another one that is about to end.
_PATIENCE = 3.0
_POLL = 0.05
#: Attempts to make a folder that no other process takes away.
_TRIES = 10
#: Characters of the name of a file in that of its lock, so that the latter is not too long for the file system.
_NAMED = 50


@contextmanager
def only_writer_of_folder(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, into which no other command then writes, and remove what killed commands left there.

    Raises:
        InputError: If another process holds the lock, or the folder cannot be written.
    """
    with _held(folder / f"{_PREFIX}folder{_LOCK_SUFFIX}", folder):
        left = [path for level in _LEVELS for path in folder.glob(f"{level}{_PREFIX}*")]
        for place in {path.parent for path in left}:
            remove_abandoned(place)
        yield


@contextmanager
def only_writer_of_file(path: Path) -> Iterator[None]:
    """Hold the lock of a file, which no other command then writes.

    Raises:
        InputError: If another process holds the lock, or the folder cannot be written.
    """
    with _held(path.parent / f"{_PREFIX}{path.name[:_NAMED]}{_LOCK_SUFFIX}", path):
        yield


@contextmanager
def scratch_folder(parent: Path) -> Iterator[Path]:
    """Make a folder that is removed at the end, or after a kill by the next process that makes one there.

    Raises:
        OSError: If the folder cannot be made.
    """
    remove_abandoned(parent)
    owner = _owned_folder(parent)
    folder = Path(owner.lock_file).parent
    try:
        yield folder
    finally:
        owner.release()
        shutil.rmtree(folder, ignore_errors=True)


def _owned_folder(parent: Path) -> BaseFileLock:
    """Make a folder and hold its lock."""
    lost: OSError = FileNotFoundError()
    for _ in range(_TRIES):
        folder = parent / f"{_PREFIX}{secrets.token_hex(4)}"
        owner = FileLock(folder / _OWNER, timeout=0, thread_local=False)
        try:
            owner.acquire()
        except (Timeout, FileNotFoundError) as error:
            lost = error  # another process has taken the new folder for one that was abandoned
            continue
        if (folder / _OWNER).is_file():
            return owner
        owner.release()
    raise lost


def remove_abandoned(parent: Path) -> None:
    """Remove the locks and scratch folders of processes that live no more, directly in a folder."""
    for path in parent.glob(f"{_PREFIX}*"):
        # a lock that is held raises Timeout, and one that another process has just removed FileNotFoundError
        with suppress(OSError):
            if path.is_dir():
                gone = path.with_name(f"{path.name}~")
                with FileLock(path / _OWNER, timeout=0, thread_local=False):
                    path.rename(gone)  # whoever is about to take the lock makes the folder anew
                shutil.rmtree(gone)
            elif path.suffix == _LOCK_SUFFIX:
                with FileLock(path, timeout=0, thread_local=False):
                    path.unlink()


@contextmanager
def _held(lock: Path, what: Path) -> Iterator[None]:
    existed = lock.parent.is_dir()
    taken = FileLock(lock, timeout=_PATIENCE, poll_interval=_POLL, thread_local=False)
    try:
        taken.acquire()
    except Timeout as error:
        raise InputError(
            f"`{what}` must be written by one command at a time, got a second one while another is running. Try again "
            "when that has ended, or another path."
        ) from error
    except OSError as error:
        raise InputError(f"`{what}` must be writable, got: {error.strerror}. Try a path in another folder.") from error
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)  # while it is held, so that nobody else's is removed
        taken.release()
        if not existed:
            with suppress(OSError):
                lock.parent.rmdir()  # where nothing was written
