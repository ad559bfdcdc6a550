"""The tally of attacks, printed at the end and, after a nightly run, written to the page on reliability."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from nightly import NIGHTLY
from table import PAGE, TALLY, Tally, table, updated


@pytest.fixture(autouse=True, scope="session")
def _one_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """All commands find the networks that the first one has fitted."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NSM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def tally() -> Tally:
    """Counts tries: ``with tally.attack("NAME"):`` around each of them."""
    return TALLY


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if TALLY.counts:
        terminalreporter.write_sep("=", "attacks")
        terminalreporter.write(table(TALLY.counts))
    if TALLY.counts and NIGHTLY:
        PAGE.write_text(updated(PAGE.read_text(), TALLY.counts))
