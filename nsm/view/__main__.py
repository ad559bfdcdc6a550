"""``python -m nsm.view``: show morphs on a page in the browser, or record them in an HTML file."""

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

from nsm.cli import entry
from nsm.cli.errors import InputError
from nsm.cli.extras import require
from nsm.cli.progress import Progress
from nsm.cli.settings import number, positive, switch, use_threads, whole_number
from nsm.io.loading import LoadedMorph, load_morphs
from nsm.metrics import even_times
from nsm.view.pictures import Settings

log = logging.getLogger(__name__)

#: Signals that end the viewer: Ctrl-C, and termination by the system.
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
#: Seconds between checks for a signal or a failure of a background thread.
_INTERVAL = 0.2
_MIB = 1 << 20
_LAST_PORT = 65535


def main(cfg: DictConfig) -> None:
    """Load the morphs, and show them until a signal ends the viewer, or record them."""
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
        raise InputError(f"`port` must be at most {_LAST_PORT}, got {port}. Try `port=8080`.")
    loaded = load_morphs(config, "nsm.view")
    from nsm.view.page import Viewer

    with _stop_signal() as stopped:
        viewer = Viewer(loaded, settings, times, seconds, memory, str(config["host"]), port)
        try:
            log.info("%s shows %s. Press Ctrl-C to end.", viewer.url, ", ".join(each.name for each in loaded))
            if switch("open_browser", config["open_browser"]):
                _open(viewer.url)
            while not stopped.wait(_INTERVAL):
                viewer.wait(0)
        finally:
            viewer.close()


def _record(file: Path, loaded: list[LoadedMorph], settings: Settings, times: list[float], seconds: float) -> None:
    from nsm.view.recording import record

    with Progress("recording", len(loaded) * len(times), unit="surfaces") as progress:
        for done in record(file, loaded, settings, times, seconds):
            progress.update(done)
    log.info("wrote %s (%.1f MB), which opens in any browser", file, file.stat().st_size / 1e6)


@contextmanager
def _stop_signal() -> Iterator[threading.Event]:
    """Provide an event that Ctrl-C and SIGTERM set instead of ending the process."""
    stopped = threading.Event()
    before = {number: signal.signal(number, lambda *_: stopped.set()) for number in _SIGNALS}
    try:
        yield stopped
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _open(url: str) -> None:
    try:
        opened = webbrowser.open(url)
    except webbrowser.Error:
        opened = False
    if not opened:
        log.warning("found no browser on this machine: open %s in one, or omit `open_browser=true`", url)


def _page_file(given: Any) -> Path:
    file = Path(str(given))
    if file.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"`record` must name an .html file, got {given}. Try `record=morph.html`.")
    return file


if __name__ == "__main__":
    entry.run(main, "view")
