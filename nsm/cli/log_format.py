"""Log messages as plain sentences on the terminal, and the log file of a run."""

from __future__ import annotations

import logging
import sys
from contextlib import suppress


class PlainFormatter(logging.Formatter):
    """Writes the message alone, after the level where that is a warning or worse.

    >>> record = logging.LogRecord("nsm", logging.WARNING, "", 0, "the volume is wrong", None, None)
    >>> PlainFormatter().format(record)
    'warning: the volume is wrong'
    """

    def format(self, record: logging.LogRecord) -> str:
        message = super().format(record)
        return message if record.levelno < logging.WARNING else f"{record.levelname.lower()}: {message}"


class LogFile(logging.FileHandler):
    """Writes messages into a file, and drops those for which its disk has no space, since the terminal shows them."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 (name of logging)
        """Close the file, which the next message opens again; any error other than the disk's is a defect."""
        if not isinstance(sys.exception(), OSError):
            super().handleError(record)
            return
        stream, self.stream = self.stream, None
        if stream is not None:
            with suppress(OSError):
                stream.close()
