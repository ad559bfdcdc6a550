"""``python -m nsm.view``: morphs on a page in the browser, or in a file that plays them there."""

from __future__ import annotations

import logging
import signal
import threading
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import Progress

from nsm.cli import entry
from nsm.cli.errors import InputError
from nsm.cli.extras import require
from nsm.cli.settings import number, positive, switch, use_threads, whole_number
from nsm.io.loading import LoadedMorph, load_morphs
from nsm.metrics import even_times
from nsm.view.frames import Settings

log = logging.getLogger(__name__)

#: What ends a viewer: Ctrl-C, and a polite request of the system.
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
#: Seconds between two looks at whether the work goes on.
_PATIENCE = 0.2
_MIB = 1 << 20
_LAST_PORT = 65535


def main(cfg: DictConfig) -> None:
    """Load the morphs and show them until somebody ends it, or record them."""
    require("viser", extra="view", task="The viewer")
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    settings = Settings(
        whole_number("resolution", config["resolution"], 8),
        switch("exact_volume", config["exact_volume"]),
        number("level", config["level"]),
        str(config["color"]),
    )
    times = even_times(whole_number("times", config["times"], 2)).tolist()
    seconds = positive("seconds", config["seconds"])
    use_threads(config)
    if config["record"] is not None:
        _record(_page_file(config["record"]), load_morphs(config, "nsm.view"), settings, times, seconds)
        return
    memory = whole_number("memory", config["memory"], 1) * _MIB
    port = config["port"]
    if port is not None and whole_number("port", port, 1) > _LAST_PORT:
        raise InputError(f"port={port} cannot be: give a number up to {_LAST_PORT}")
    subjects = load_morphs(config, "nsm.view")
    from nsm.view.page import Viewer

    with _until_told() as told:
        viewer = Viewer(subjects, settings, times, seconds, memory, str(config["host"]), port)
        try:
            log.info("%s shows %s; Ctrl-C ends it", viewer.url, ", ".join(subject.name for subject in subjects))
            if switch("open_browser", config["open_browser"]):
                _open(viewer.url)
            while not told.wait(_PATIENCE):
                viewer.wait(0)
        finally:
            viewer.close()


def _record(file: Path, subjects: list[LoadedMorph], settings: Settings, times: list[float], seconds: float) -> None:
    from nsm.view.recording import record

    with Progress(console=Console(stderr=True)) as bar:
        work = record(file, subjects, settings, times, seconds)
        for _ in bar.track(work, len(subjects) * len(times), description="recording"):
            pass
    log.info("wrote %s, %.1f MB: it opens in a browser", file, file.stat().st_size / 1e6)


@contextmanager
def _until_told() -> Iterator[threading.Event]:
    """An event that is set by Ctrl-C or SIGTERM, which then end nothing by themselves."""
    told = threading.Event()
    before = {number: signal.signal(number, lambda *_: told.set()) for number in _SIGNALS}
    try:
        yield told
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _open(url: str) -> None:
    try:
        opened = webbrowser.open(url)
    except webbrowser.Error:
        opened = False
    if not opened:
        log.warning("no browser is found on this machine: open %s in one, or leave out open_browser=true", url)


def _page_file(given: Any) -> Path:
    file = Path(str(given))
    if file.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"record={given} is no page: give a name that ends in .html, such as record=morph.html")
    return file


if __name__ == "__main__":
    entry.run(main, "view")
