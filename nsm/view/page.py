"""The page: pictures are computed in the background and shown as soon as they are ready."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

import viser

from nsm.cli.errors import InputError
from nsm.io.loading import LoadedMorph
from nsm.plots.colors import COLORS
from nsm.view.controls import Controls, percent
from nsm.view.pictures import PictureMaker, Settings, Surface, can_color
from nsm.view.scene import Scene
from nsm.view.stage import Extent
from nsm.view.store import Key, Store

#: Updates per second of playback, more than a morph has times in it.
_TICKS = 30
#: Seconds to wait for threads at the end; a picture that takes longer is abandoned when the process exits.
_PATIENCE = 2.0


class Viewer:
    """Page in the browser that shows morphs side by side at one common time.

    One thread computes pictures, that of the wanted time first; another advances time during playback. All browsers
    that have the page open show the same.

    Args:
        server: Server of the page, which stays open when the viewer is closed.
        loaded: The morphs, all of one dimension.
        settings: Initial settings.
        times: At least two times in [0, 1], one per picture.
        seconds: Seconds of playback from t = 0 to t = 1.
        memory: Memory for pictures in bytes.

    Raises:
        InputError: If the morphs are of different dimensions, or none has the velocity that the color needs.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        loaded: Sequence[LoadedMorph],
        settings: Settings,
        times: Sequence[float],
        seconds: float = 6.0,
        memory: int = 1 << 30,
    ) -> None:
        names, morphs = [each.name for each in loaded], [each.morph for each in loaded]
        dim = one_dimension(loaded)
        settings.check(morphs)
        self.server = server
        self.times, self.seconds = times, seconds
        self._makers = [PictureMaker(morph) for morph in morphs]
        self._store = Store(len(loaded), len(times), settings, memory)
        edge = max(float((morph.bounds[1] - morph.bounds[0]).max()) for morph in morphs)
        colors = [name for name in COLORS if any(can_color(morph, name) for morph in morphs)]
        self._scene = Scene(self.server, names, [Extent.of(morph) for morph in morphs], dim)
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
    def time(self) -> int:
        """Index of the wanted time."""
        return self._store.time

    @property
    def shown(self) -> set[Key]:
        """Keys of the visible pictures, one per morph."""
        return self._scene.shown

    @property
    def settings(self) -> Settings:
        """Settings that the controls show."""
        return self._controls.settings

    @property
    def figures(self) -> str:
        """The table of figures as Markdown."""
        return self._controls.figures

    def play(self, on: bool) -> None:
        """Start or stop playback."""
        self._controls.play(on)

    def go(self, number: int) -> None:
        """Show the time of an index; until its picture is ready, the nearest that is."""
        self._clock = self.times[number]
        self._store.want(time=number)
        self._refresh()

    def choose(self, settings: Settings) -> None:
        """Compute and show pictures with other settings."""
        self._store.want(settings=settings)
        self._refresh()
        self._report()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the viewer is closed, at most for a time in seconds, and return whether it is.

        Raises:
            Exception: The exception that ended a background thread, if one failed.
        """
        self._ended.wait(timeout)
        if self._error is not None:
            raise self._error
        return self._ended.is_set()

    def close(self) -> None:
        """End the threads; the page stays as it is."""
        self._ended.set()
        self._store.close()
        for thread in self.threads:
            thread.join(_PATIENCE)

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BaseException as error:  # raised again by `wait`
            self._error = error
            self._ended.set()

    def _make(self) -> None:
        """Compute one picture after the other."""
        while (key := self._store.next()) is not None:
            maker, instant = self._makers[key.morph], self.times[key.time]
            surface = self._store.surface(key) or maker.surface(instant, key.settings)
            picture = maker.picture(surface, instant, key.settings)
            if self._ended.is_set():
                return
            with self._lock:
                self._scene.add(key, picture.glb)
                self._scene.remove(self._store.put(key, picture))
                self._refresh()
                self._report()

    def _run(self) -> None:
        """Advance time back and forth during playback."""
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
        """Show the pictures nearest to the wanted time; a morph without one in these settings keeps its old picture."""
        with self._lock:
            nearest = {morph: self._store.nearest(morph) for morph in range(len(self._makers))}
            keys = {morph: key for morph, key in nearest.items() if key is not None}
            surfaces = {morph: self._surface(key) for morph, key in keys.items()}
            captions = {morph: caption(self.times[keys[morph].time], surface) for morph, surface in surfaces.items()}
            self._scene.show(keys, captions)
            self._store.show(self._scene.shown)
            self._controls.show_figures(surfaces)

    def _report(self) -> None:
        """Update the progress and the plot of volumes."""
        with self._lock:
            self._report_on(self._store.ready())

    def _report_on(self, ready: list[Key]) -> None:
        of = len(self._makers) * len(self.times)
        self._controls.show_progress(len(ready), of, self._store.complete)
        known = [{key.time: key for key in ready if key.morph == n} for n in range(len(self._makers))]
        common = sorted(set.intersection(*(set(row) for row in known)))
        rows = [[self._surface(row[number]).deviation for number in common] for row in known]
        self._controls.draw([self.times[number] for number in common], rows)

    def _surface(self, key: Key) -> Surface:
        picture = self._store.get(key)
        assert picture is not None  # pictures are dropped only by the thread that holds the lock
        return picture.surface


def caption(instant: float, surface: Surface) -> str:
    """Caption below a morph: its time, and the deviation of its volume."""
    if not len(surface.mesh.simplices):
        return f"t = {instant:.2f}   no surface"
    return f"t = {instant:.2f}   {percent(surface.deviation)}"


def one_dimension(loaded: Sequence[LoadedMorph]) -> int:
    """Return the common dimension of morphs.

    Raises:
        InputError: If they are of different dimensions.
    """
    dims = {each.morph.dim for each in loaded}
    if len(dims) > 1:
        raise InputError(
            "Morphs in one `nsm view` must have the same dimension, got 2D and 3D. Try one command for each."
        )
    return dims.pop()
