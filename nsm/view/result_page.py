"""The third part of the studio: the trained morph, and its files."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import viser

from nsm.cli.errors import InputError
from nsm.cli.overrides import literal
from nsm.io.loading import LoadedMorph
from nsm.view.job import Job
from nsm.view.notice import Notice
from nsm.view.page import Viewer
from nsm.view.pictures import Settings
from nsm.view.server import clear_panel

#: Seconds between two looks at what a command prints.
_INTERVAL = 0.5


class Viewing(NamedTuple):
    """How a morph is shown: see `Viewer`."""

    settings: Settings
    times: Sequence[float]
    seconds: float
    memory: int


class ResultPage:
    """A trained morph with all controls of the viewer, and buttons that download it.

    Args:
        server: Server of the page.
        loaded: The morph, whose folder is that of its run.
        viewing: How it is shown.
        again: Called to begin another morph.
        hint: What the page says at first.
    """

    def __init__(
        self, server: viser.ViserServer, loaded: LoadedMorph, viewing: Viewing, again: Callable[[], object], hint: str
    ) -> None:
        self.server, self._loaded, self._viewing = server, loaded, viewing
        clear_panel(server)  # the surfaces of training stay until those of the morph replace them
        self._notice = Notice(server, hint)
        gui, guard = server.gui, self._notice.guard
        with gui.add_folder("Morph"):
            self._buttons = {
                suffix: gui.add_button(f"Download {suffix.upper()}", icon=viser.Icon.DOWNLOAD, disabled=True)
                for suffix in (("glb", "mp4") if loaded.morph.dim == 3 else ("mp4",))
            }
            new = gui.add_button("New morph", icon=viser.Icon.ARROW_BACK_UP)
        new.on_click(guard(lambda event: again()))
        self._job: Job | None = None
        self._lock = threading.Lock()
        self.viewer = Viewer(server, [loaded], *viewing)
        for suffix, button in self._buttons.items():
            button.on_click(guard(partial(self.download, suffix)))
            button.disabled = False

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        assert self._loaded.folder is not None  # it was trained here
        return self._loaded.folder

    @property
    def said(self) -> str:
        """The sentence at the top of the panel, as HTML."""
        return self._notice.content

    def download(self, suffix: str, event: Any) -> None:
        """Write the morph as a file and send it to the browser that asked for it, or say why it cannot be written.

        Raises:
            InputError: If another one is being written.
        """
        if not self._lock.acquire(blocking=False):
            raise InputError("One `Download` must end before the next, got a second click. Try again when it has.")
        try:
            file = self.folder / "downloads" / f"{self._loaded.name}.{suffix}"
            self._notice.say(f"Writing {file} …")
            overrides = [f"checkpoint={literal(self._loaded.origin)}", f"output={literal(str(file))}"]
            command, settings = self._command(suffix)
            self._job = Job(command, [*overrides, *settings], self.folder / "downloads" / f"{suffix}.log")
            while not self._job.wait(_INTERVAL):
                self._notice.say(f"Writing {file} … {self._job.last_line()}")
            if (error := self._job.error()) is not None:
                self._notice.warn(error)
                return
            self._notice.say(f"Wrote {file}.")
            event.client.send_file_download(file.name, file.read_bytes(), save_immediately=True)
        finally:
            self._lock.release()

    def _command(self, suffix: str) -> tuple[str, list[str]]:
        """Command and settings that write a file as the page shows the morph."""
        chosen = self.viewer.settings
        common = [
            f"resolution={chosen.resolution}", f"exact_volume={str(chosen.exact).lower()}",
            f"seconds={self._viewing.seconds}",
        ]  # fmt: skip
        if suffix == "glb":
            return "export", [*common, "format=glb"]
        return "render", [*common, "kind=film", f"color={chosen.color}"]

    def close(self) -> None:
        """End the viewer, and what is being written."""
        if self._job is not None:
            self._job.close()
        self.viewer.close()
