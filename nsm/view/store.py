"""Cache of pictures with bounded memory, which also decides what to compute next."""

from __future__ import annotations

import threading
from typing import NamedTuple

from nsm.view.pictures import Picture, Settings, Surface


class Key(NamedTuple):
    """Identity of a picture: index of the morph, index of the time, settings."""

    morph: int
    time: int
    settings: Settings


class Store:
    """Thread-safe cache of pictures, nearest to the wanted time first.

    Pictures of the wanted time rank first, then those near it in time, then those with other settings, the most recent
    settings first. Pictures are computed and kept in this order, as many as fit in memory; those that are visible and
    those of the wanted time are always kept.

    Args:
        morphs: Number of morphs.
        times: Number of times.
        settings: Settings of the pictures that are wanted first.
        limit: Memory in bytes.
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
        """Change the wanted time, the wanted settings, or both."""
        with self._changed:
            self.time = self.time if time is None else time
            if settings is not None and settings != self.settings:
                self.settings = settings
                # moved to the end, so that they are dropped last once the settings change again
                for key in [key for key in self._held if key.settings == settings]:
                    self._held[key] = self._held.pop(key)
            self._changed.notify_all()

    def show(self, keys: set[Key]) -> None:
        """Set which pictures are visible."""
        with self._changed:
            self._shown = set(keys)

    def get(self, key: Key) -> Picture | None:
        """Return a picture, None if it is not in the cache."""
        return self._held.get(key)

    def nearest(self, morph: int) -> Key | None:
        """Find the cached picture of a morph with the wanted settings that is nearest to the wanted time, if any."""
        with self._changed:
            ready = [key for key in self._held if key.morph == morph and key.settings == self.settings]
            return min(ready, key=lambda key: abs(key.time - self.time), default=None)

    def ready(self) -> list[Key]:
        """List all cached pictures with the wanted settings."""
        with self._changed:
            return [key for key in self._held if key.settings == self.settings]

    def surface(self, key: Key) -> Surface | None:
        """Find the surface of a picture in a cached one that differs only in color."""
        with self._changed:
            for other, picture in self._held.items():
                if (other.morph, other.time, other.settings[:3]) == (key.morph, key.time, key.settings[:3]):
                    return picture.surface
            return None

    def next(self, timeout: float | None = None) -> Key | None:
        """Wait for a picture that must be computed; None once the cache is closed, or at the timeout."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._missing() is not None, timeout)
            return None if self._closed else self._missing()

    @property
    def complete(self) -> bool:
        """Whether all pictures that are wanted and fit in memory have been computed."""
        with self._changed:
            return self._missing() is None

    def put(self, key: Key, picture: Picture) -> list[Key]:
        """Add a picture, and return the keys of those that were dropped for it."""
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
        """Release all threads that wait for work."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _rank(self, key: Key) -> tuple[int, int, int]:
        """Rank of a picture: the smallest is computed first and dropped last."""
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
