"""Errors about files that cannot be read."""

from __future__ import annotations

from pathlib import Path

from nsm.cli.errors import InputError

#: Maximum number of characters of the message of a reader that an error repeats.
_MAX_DETAIL = 80


def require_content(file: Path, content: str) -> None:
    """Reject an empty file.

    Args:
        file: The file.
        content: Description of what the file should contain, such as "a mesh".

    Raises:
        InputError: If the size of the file is zero.
    """
    if file.stat().st_size == 0:
        raise InputError(f"`{file}` must contain {content}, got an empty file. Try to export it again.")


def unreadable(file: Path, content: str, error: Exception) -> InputError:
    """Create the error for a damaged file, ready to be raised.

    Args:
        file: The file.
        content: Description of what the file should contain, such as "a mesh".
        error: The error of the reader.
    """
    return InputError(
        f"`{file}` must contain {content} in the format of its extension, got {type(error).__name__}: "
        f"{str(error)[:_MAX_DETAIL]}. Try to export it again; the file may be truncated."
    )
