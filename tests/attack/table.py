"""How often each attack was tried and how often nsm held: counted by the tests of this folder, shown as one table."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: The page that holds the table of the nightly run.
PAGE = Path(__file__).resolve().parents[2] / "docs" / "reliability.md"
_HEAD = "| attack | tried | held |\n| --- | ---: | ---: |\n"
_ROW = re.compile(r"^\| (.+) \| (\d+) \| (\d+) \|\n", re.MULTILINE)


class Tally:
    """Counts of tries and of successes by the names of attacks.

    >>> tally = Tally()
    >>> with tally.attack("a cut checkpoint"):
    ...     pass
    >>> tally.counts
    {'a cut checkpoint': (1, 1)}
    """

    def __init__(self) -> None:
        self.counts: dict[str, tuple[int, int]] = {}

    @contextmanager
    def attack(self, name: str) -> Iterator[None]:
        """Count one try, which held if the block raises nothing."""
        tried, held = self.counts.get(name, (0, 0))
        self.counts[name] = tried + 1, held
        yield
        tried, held = self.counts[name]
        self.counts[name] = tried, held + 1


#: The counts of this process.
TALLY = Tally()


def table(counts: dict[str, tuple[int, int]]) -> str:
    """The counts as a table in Markdown."""
    return _HEAD + "".join(f"| {name} | {tried} | {held} |\n" for name, (tried, held) in sorted(counts.items()))


def read(page: str) -> dict[str, tuple[int, int]]:
    """The counts that the table of a page shows."""
    _, _, rows = page.partition(_HEAD)
    return {name: (int(tried), int(held)) for name, tried, held in _ROW.findall(rows)}


def updated(page: str, counts: dict[str, tuple[int, int]]) -> str:
    """The page with the counts in its table; rows of attacks that were not run stay."""
    before = read(page)
    return page.replace(table(before), table(before | counts))
