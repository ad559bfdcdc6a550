"""The pictures that are held, and which is to be made next."""

from __future__ import annotations

import threading
from typing import NamedTuple

from nsm.view.frames import Picture, Settings, Surface


class Key(NamedTuple):
    """Which picture: number of the morph, number of the time, settings."""

    morph: int
    time: int
    settings: Settings


class Store:
    """Pictures within a bound of memory, those nearest to the wanted time first; for any number of threads.

    What is wanted now ranks before what is near it in time, and both before pictures with other settings, the latest
    of which rank first. Pictures are made and kept in this order, as many as the memory holds; those on show, and
    those of the wanted time, are kept in any case.

    Args:
        morphs: how many morphs there are.
        times: how many times.
        settings: of the pictures that are wanted first.
        limit: memory in bytes.
    """

    def __init__(self, morphs: int, times: int, settings: Settings, limit: int) -> None:
        self.morphs, self.times, self.limit = morphs, times, limit
        self.settings, self.time = settings, 0
        self.size = 0
        self._held: dict[Key, Picture] = {}
        self._shown: set[Key] = set()
        self._changed = threading.Condition()
        self._closed = False

    def want(self, time: int | None = None, settings: Settings | None = None) -> None:
        """Change the time, or the settings, that are wanted."""
        with self._changed:
            self.time = self.time if time is None else time
            if settings is not None and settings != self.settings:
                self.settings = settings
                for key in [key for key in self._held if key.settings == settings]:
                    self._held[key] = self._held.pop(key)  # the latest to be dropped once the settings change again
            self._changed.notify_all()

    def show(self, keys: set[Key]) -> None:
        """Say which pictures are on show."""
        with self._changed:
            self._shown = set(keys)

    def get(self, key: Key) -> Picture | None:
        """A picture, None if it is not held."""
        return self._held.get(key)

    def nearest(self, morph: int) -> Key | None:
        """The held picture of a morph with the wanted settings, nearest to the wanted time; None if there is none."""
        with self._changed:
            ready = [key for key in self._held if key.morph == morph and key.settings == self.settings]
            return min(ready, key=lambda key: abs(key.time - self.time), default=None)

    def ready(self) -> list[Key]:
        """All held pictures with the wanted settings."""
        with self._changed:
            return [key for key in self._held if key.settings == self.settings]

    def surface(self, key: Key) -> Surface | None:
        """The surface of a picture, from a held one that differs in color only."""
        with self._changed:
            for other, picture in self._held.items():
                if (other.morph, other.time, other.settings[:3]) == (key.morph, key.time, key.settings[:3]):
                    return picture.surface
            return None

    def next(self, timeout: float | None = None) -> Key | None:
        """Wait for a picture that is to be made; None once the store is closed, or at the timeout."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._missing() is not None, timeout)
            return None if self._closed else self._missing()

    @property
    def complete(self) -> bool:
        """Whether all pictures are made that are wanted and find room."""
        with self._changed:
            return self._missing() is None

    def put(self, key: Key, picture: Picture) -> list[Key]:
        """Take a picture in; returns those that had to go for it."""
        with self._changed:
            self._held[key] = picture
            self.size += picture.size
            gone: list[Key] = []
            if self.size <= self.limit:
                return gone
            for other in sorted(self._held.keys() - self._shown - {key}, key=self._rank, reverse=True):
                if self.size > self.limit and not self._is_wanted(other):
                    self.size -= self._held.pop(other).size
                    gone.append(other)
            return gone

    def close(self) -> None:
        """Let all who wait go."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _rank(self, key: Key) -> tuple[int, int, int]:
        """The smaller, the sooner it is made and the later it is dropped."""
        if key.settings != self.settings:
            return 1, -list(self._held).index(key), 0
        return 0, abs(key.time - self.time), key.morph

    def _is_wanted(self, key: Key) -> bool:
        return (key.time, key.settings) == (self.time, self.settings)

    def _missing(self) -> Key | None:
        wanted = (Key(morph, time, self.settings) for morph in range(self.morphs) for time in range(self.times))
        best = min((key for key in wanted if key not in self._held), key=self._rank, default=None)
        if best is None or self._is_wanted(best):
            return best
        alike = [picture.size for key, picture in self._held.items() if key.settings == self.settings]
        if self.size + (max(alike) if alike else 0) <= self.limit:
            return best
        worst = max((self._rank(key) for key in self._held if key not in self._shown), default=None)
        return best if worst is not None and self._rank(best) < worst else None
