"""``python -m nsm.view``: show morphs on a page in the browser, or record them in an HTML file."""

from __future__ import annotations

import logging
import signal
import threading
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from nsm.cli import entry
from nsm.cli.errors import InputError
from nsm.cli.extras import require
from nsm.cli.locks import only_writer_of_file
from nsm.cli.progress import Progress
from nsm.cli.settings import invalid, use_threads
from nsm.io.loading import LoadedMorph, load_morphs, retimed
from nsm.metrics import even_times
from nsm.view.pictures import Settings

if TYPE_CHECKING:
    from nsm.view.studio import Workplace

log = logging.getLogger(__name__)

#: Signals that end the viewer: Ctrl-C, and termination by the system.
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
#: Seconds between checks for a signal or a failure of a background thread.
_INTERVAL = 0.2
_MIB = 1 << 20


def main(cfg: DictConfig) -> None:
    """Show morphs, or a page to train one, until a signal ends the viewer; or record morphs."""
    require("viser", extra="view", task="The viewer")
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    settings = Settings(config["resolution"], config["exact_volume"], config["level"], config["color"])
    times = even_times(config["times"]).tolist()
    seconds = float(config["seconds"])
    use_threads(config)
    if config["record"] is not None:
        _record(_page_file(config["record"]), _loaded(config), settings, times, seconds)
        return
    from nsm.view.page import Viewer
    from nsm.view.result_page import Viewing
    from nsm.view.server import open_page, page_address
    from nsm.view.studio import Studio

    viewing = Viewing(settings, times, seconds, config["memory"] * _MIB)
    named = config["checkpoint"] is not None or config["official"] is not None
    loaded = _loaded(config) if named else []
    workplace = _workplace(config)
    with _stop_signal() as stopped, open_page(config["host"], config["port"]) as server:
        shown = Viewer(server, loaded, *viewing) if named else Studio(server, viewing, workplace)
        try:
            address = page_address(server)
            what = f"shows {', '.join(each.name for each in loaded)}" if named else "waits for two files of shapes"
            log.info("%s %s. Press Ctrl-C to end.", address, what)
            if config["open_browser"]:
                _open(address)
            while not stopped.wait(_INTERVAL):
                shown.wait(0)
        finally:
            shown.close()


def _loaded(config: dict[str, Any]) -> list[LoadedMorph]:
    """The morphs at the times of the slider, which follow the timing."""
    return retimed(load_morphs(config, "nsm.view"), config["timing"])


def _workplace(config: dict[str, Any]) -> Workplace:
    """Where and how morphs are trained on the page."""
    from nsm.view.studio import Workplace

    train = config["train"]
    if not all(isinstance(override, str) for override in train):
        raise invalid("train", "a list of settings of training", train, "['method=nulldiv']")
    threads = [] if config["threads"] is None else [f"threads={config['threads']}"]
    return Workplace(Path(config["runs"]), config["upload"] * _MIB, [*threads, *train])


def _record(file: Path, loaded: list[LoadedMorph], settings: Settings, times: list[float], seconds: float) -> None:
    from nsm.view.recording import record

    with only_writer_of_file(file), Progress("recording", len(loaded) * len(times), unit="surfaces") as progress:
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
