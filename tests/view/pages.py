"""Pages of the viewer, with morphs of known weights."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from analytic import run_here

from nsm.io.loading import LoadedMorph
from nsm.view.job import Job
from nsm.view.page import Viewer
from nsm.view.pictures import Settings
from nsm.view.result_page import Viewing
from nsm.view.server import open_page
from nsm.view.studio import Studio, Workplace


@contextmanager
def shown(
    loaded: Sequence[LoadedMorph], settings: Settings, times: Sequence[float], **options: Any
) -> Iterator[Viewer]:
    """Show morphs on a page of this machine for the time of the context."""
    with open_page("127.0.0.1", None) as server:
        viewer = Viewer(server, loaded, settings, times, **options)
        try:
            yield viewer
        finally:
            viewer.close()


@contextmanager
def studio_page(
    runs: Path, overrides: Sequence[str] = (), *, limit: int = 1 << 20, resolution: int = 16, times: int = 3
) -> Iterator[Studio]:
    """Open a studio on a page of this machine for the time of the context."""
    viewing = Viewing(Settings(resolution), [number / (times - 1) for number in range(times)], 0.2, 1 << 28)
    with open_page("127.0.0.1", None) as server:
        studio = Studio(server, viewing, Workplace(runs, limit, list(overrides)))
        try:
            yield studio
        finally:
            studio.close()


class JobHere(Job):
    """A command of the page in this process, which saves the start of another; it has ended when it is there."""

    def __init__(self, command: str, overrides: Sequence[str], log: Path) -> None:
        self.command, self.log, self.stopped = command, log, False
        log.parent.mkdir(parents=True, exist_ok=True)
        with log.open("w") as output, redirect_stdout(output), redirect_stderr(output):
            code = run_here(import_module(f"nsm.{command}.__main__"), *overrides)
        ended = SimpleNamespace(poll=lambda: code, wait=lambda timeout=None: code)
        self._process = cast("subprocess.Popen[bytes]", ended)
