"""The sentence at the top of the panel, and callbacks whose errors appear in it."""

from __future__ import annotations

import html
import logging
from collections.abc import Callable
from typing import Any

import viser

from nsm.cli.errors import InputError

log = logging.getLogger(__name__)

#: Colors of the text of a hint and of an error.
_HINT, _ERROR = "inherit", "#c92a2a"


class Notice:
    """A sentence in the panel of a page.

    Args:
        server: Server of the page.
        text: What it says at first.
    """

    def __init__(self, server: viser.ViserServer, text: str = "") -> None:
        self._handle = server.gui.add_html("")
        self.say(text)

    @property
    def content(self) -> str:
        """What the page shows, as HTML."""
        return str(self._handle.content)

    def say(self, text: str) -> None:
        """Show a hint."""
        self._handle.content = styled(text, _HINT)

    def warn(self, text: str) -> None:
        """Show an error."""
        self._handle.content = styled(text, _ERROR)

    def guard(self, action: Callable[[Any], object]) -> Callable[[Any], None]:
        """Let a callback of the page show its errors here: their sentence, or where a defect is described."""

        def guarded(event: Any) -> None:
            try:
                action(event)
            except InputError as error:
                self.warn(str(error))
            except Exception as error:
                log.exception("a callback of the page failed")
                self.warn(
                    f"The page must handle every input, got {type(error).__name__}. Try to read the traceback in the "
                    "terminal, and report it."
                )

        return guarded


def styled(text: str, color: str = _HINT) -> str:
    """Write a text as a small block of HTML, with what is between backticks as code.

    >>> styled("Try `a<b`.")[-30:]
    'Try <code>a&lt;b</code>.</div>'
    """
    parts = html.escape(text).split("`")
    marked = "".join(f"<code>{part}</code>" if number % 2 else part for number, part in enumerate(parts))
    return f'<div style="font-size:0.85em;padding:0 0.8em 0.5em;color:{color};overflow-wrap:anywhere">{marked}</div>'
