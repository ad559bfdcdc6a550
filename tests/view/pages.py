"""Pages of the viewer, with morphs of known weights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from nsm.io.loading import LoadedMorph
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
