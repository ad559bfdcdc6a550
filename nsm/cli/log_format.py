"""Log messages as plain sentences on the terminal."""

from __future__ import annotations

import logging


class PlainFormatter(logging.Formatter):
    """Writes the message alone, after the level where that is a warning or worse.

    >>> record = logging.LogRecord("nsm", logging.WARNING, "", 0, "the volume is wrong", None, None)
    >>> PlainFormatter().format(record)
    'warning: the volume is wrong'
    """

    def format(self, record: logging.LogRecord) -> str:
        message = super().format(record)
        return message if record.levelno < logging.WARNING else f"{record.levelname.lower()}: {message}"
