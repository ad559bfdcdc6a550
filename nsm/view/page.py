"""The page: pictures computed beside it, and shown as soon as they are there."""

from __future__ import annotations

import contextlib
import io
import logging
import socket
import threading
import time
from collections.abc import Callable, Sequence

import viser

from nsm.cli.errors import InputError
from nsm.io.loading import LoadedMorph
from nsm.view.controls import Controls, percent
from nsm.view.frames import COLORS, Photographer, Settings, Surface, can_color
from nsm.view.stage import Extent, Stage
from nsm.view.store import Key, Store

#: Looks at the clock in a second of play: more than frames that a morph has in it.
_TICKS = 30
#: Seconds that a picture in the making may hold up the end; what is left of it then ends with the program.
_PATIENCE = 2.0
#: Ports that are tried for one that is free.
_TRIED = 100


class Viewer:
    """Morphs side by side on a page in the browser, with one time for all.

    A thread makes the pictures, that of the wanted time first; another one plays. Whatever there is to see is seen by
    everybody who has the page open.

    Args:
        subjects: the morphs, all of one dimension.
        settings: to begin with.
        times: from 0 to 1, one a frame; at least two.
        seconds: that a morph takes from 0 to 1 when it is played.
        memory: for pictures, in bytes.
        host: the address of the page.
        port: of the page; None takes one that is free.

    Raises:
        InputError: if the port is not free, the host is none of this machine's, the morphs are not of one dimension,
            or cannot be colored so.
    """

    def __init__(
        self,
        subjects: Sequence[LoadedMorph],
        settings: Settings,
        times: Sequence[float],
        seconds: float = 6.0,
        memory: int = 1 << 30,
        host: str = "127.0.0.1",
        port: int | None = None,
    ) -> None:
        names, morphs = [subject.name for subject in subjects], [subject.morph for subject in subjects]
        dim = one_dimension(subjects)
        settings.check(morphs)
        self.server = open_server(host, port)
        self.times, self.seconds = times, seconds
        self._photographers = [Photographer(morph) for morph in morphs]
        self._store = Store(len(subjects), len(times), settings, memory)
        edge = max(float((morph.bounds[1] - morph.bounds[0]).max()) for morph in morphs)
        colors = [name for name in COLORS if any(can_color(morph, name) for morph in morphs)]
        self._stage = Stage(self.server, names, [Extent.of(morph) for morph in morphs], dim)
        self._controls = Controls(self.server, names, times, settings, colors, edge, dim)
        self._controls.on_time = self.go
        self._controls.on_settings = self.choose
        self._lock = threading.RLock()
        self._clock = 0.0
        self._ended = threading.Event()
        self._error: BaseException | None = None
        self.threads = [threading.Thread(target=self._guarded, args=(f,), daemon=True) for f in (self._make, self._run)]
        for thread in self.threads:
            thread.start()

    @property
    def url(self) -> str:
        """Where the page is."""
        host = self.server.get_host()
        return f"http://{'127.0.0.1' if host in ('0.0.0.0', '::') else host}:{self.server.get_port()}"

    @property
    def time(self) -> int:
        """The number of the frame that is wanted."""
        return self._store.time

    @property
    def shown(self) -> set[Key]:
        """The pictures that are visible, one a morph."""
        return self._stage.shown

    @property
    def figures(self) -> str:
        """The table beside them, in Markdown."""
        return self._controls.figures

    def play(self, on: bool) -> None:
        """Set the morphs in motion, or stop them."""
        self._controls.play(on)

    def go(self, number: int) -> None:
        """Show the frame of a number, or the nearest that there is until it is made."""
        self._clock = self.times[number]
        self._store.want(time=number)
        self._refresh()

    def choose(self, settings: Settings) -> None:
        """Make and show frames with other settings."""
        self._store.want(settings=settings)
        self._refresh()
        self._report()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the viewer is closed; returns whether it is.

        Raises:
            Exception: whatever ended the work, if it ended by itself.
        """
        self._ended.wait(timeout)
        if self._error is not None:
            raise self._error
        return self._ended.is_set()

    def close(self) -> None:
        """End the work and close the page."""
        self._ended.set()
        self._store.close()
        for thread in self.threads:
            thread.join(_PATIENCE)
        close_server(self.server)

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BaseException as error:  # it is raised again in the thread that waits
            self._error = error
            self._ended.set()

    def _make(self) -> None:
        """Make one picture after the other."""
        while (key := self._store.next()) is not None:
            photographer, instant = self._photographers[key.morph], self.times[key.time]
            surface = self._store.surface(key) or photographer.surface(instant, key.settings)
            picture = photographer.picture(surface, instant, key.settings)
            if self._ended.is_set():
                return
            with self._lock:
                self._stage.add(key, picture.glb)
                self._stage.remove(self._store.put(key, picture))
                self._refresh()
                self._report()

    def _run(self) -> None:
        """Move time to and fro while it is played."""
        before, direction = time.monotonic(), 1
        while not self._ended.wait(1 / _TICKS):
            now = time.monotonic()
            if self._controls.playing:
                clock = self._clock + direction * self._controls.speed * (now - before) / self.seconds
                if not 0 <= clock <= 1:
                    direction = 1 if clock < 0 else -1
                    clock = min(max(clock, 0.0), 1.0)
                number = round(clock * (len(self.times) - 1))
                if number != self._store.time:
                    self._controls.move(number)
                    self.go(number)
                self._clock = clock
            before = now

    def _refresh(self) -> None:
        """Show what is nearest to what is wanted; where nothing with these settings is ready, what was there stays."""
        with self._lock:
            nearest = {morph: self._store.nearest(morph) for morph in range(len(self._photographers))}
            keys = {morph: key for morph, key in nearest.items() if key is not None}
            surfaces = {morph: self._surface(key) for morph, key in keys.items()}
            captions = {morph: caption(self.times[keys[morph].time], surface) for morph, surface in surfaces.items()}
            self._stage.show(keys, captions)
            self._store.show(self._stage.shown)
            self._controls.tell(surfaces)

    def _report(self) -> None:
        """Tell how far the work is, and the volumes that are known."""
        with self._lock:
            self._report_on(self._store.ready())

    def _report_on(self, ready: list[Key]) -> None:
        of = len(self._photographers) * len(self.times)
        self._controls.tell_progress(len(ready), of, self._store.complete)
        known = [{key.time: key for key in ready if key.morph == n} for n in range(len(self._photographers))]
        common = sorted(set.intersection(*(set(row) for row in known)))
        rows = [[self._surface(row[number]).deviation for number in common] for row in known]
        self._controls.draw([self.times[number] for number in common], rows)

    def _surface(self, key: Key) -> Surface:
        picture = self._store.get(key)
        assert picture is not None  # only this thread, which holds the lock, lets pictures go
        return picture.surface


def caption(instant: float, surface: Surface) -> str:
    """The line below a morph."""
    if not len(surface.mesh.simplices):
        return f"t = {instant:.2f}   no surface"
    return f"t = {instant:.2f}   {percent(surface.deviation)}"


def one_dimension(subjects: Sequence[LoadedMorph]) -> int:
    """The dimension of all morphs.

    Raises:
        InputError: if they have not the same.
    """
    dims = {subject.morph.dim for subject in subjects}
    if len(dims) > 1:
        raise InputError("morphs in 2D and in 3D do not stand side by side: view them in two commands")
    return dims.pop()


def open_server(host: str, port: int | None) -> viser.ViserServer:
    """A page with nothing on it.

    Args:
        host: its address.
        port: that it shall have; None takes one that is free.

    Raises:
        InputError: if the port is not free, or the host is none of this machine's.
    """
    free = free_port(host, 0 if port is None else port)
    # viser would take the next port and say so on a page that nobody then looks for
    if port not in (None, free):
        raise InputError(f"port={port} of {host} is taken: give another such as port={free}")
    logging.getLogger("websockets").setLevel(logging.WARNING)  # every connection
    with contextlib.redirect_stdout(io.StringIO()):  # a table of addresses
        server = viser.ViserServer(host, free, verbose=False)
    if server.get_port() != free:  # somebody was faster
        close_server(server)
        raise InputError(f"port={free} of {host} is taken: give another such as port={free_port(host, free)}")
    return server


def close_server(server: viser.ViserServer) -> None:
    """Close a page without a word."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def free_port(host: str, first: int) -> int:
    """A port that is free: ``first`` or one soon after it; any if ``first`` is 0.

    Raises:
        InputError: if there is none, or the host is none of this machine's.
    """
    reason = ""
    for port in range(first, min(first + _TRIED, 1 << 16)):
        try:
            with socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET) as bound:
                return int(bound.getsockname()[1])
        except OSError as error:
            reason = error.strerror or str(error)
    raise InputError(f"no page can be opened on host={host}, port={first} ({reason}): give host=127.0.0.1 port=8080")
