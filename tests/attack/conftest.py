"""The tally of attacks, printed at the end and, after a nightly run, written to the page on reliability."""

from __future__ import annotations

import pytest
from table import NIGHTLY, PAGE, TALLY, Tally, table, updated


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
