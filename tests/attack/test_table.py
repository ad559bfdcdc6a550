"""The table of attacks counts what held, and a nightly run replaces the rows of its own attacks only."""

from __future__ import annotations

import pytest
from table import PAGE, Tally, read, table, updated


def test_a_try_that_fails_is_counted_as_tried_and_not_as_held() -> None:
    tally = Tally()
    with tally.attack("kill"):
        pass
    with pytest.raises(AssertionError), tally.attack("kill"):
        raise AssertionError
    assert tally.counts == {"kill": (2, 1)}


def test_rows_of_other_attacks_stay() -> None:
    page = "before\n\n" + table({"cut": (3, 3), "kill": (2, 1)}) + "\nafter\n"
    new = updated(page, {"full": (1, 1), "kill": (20, 20)})
    assert new == "before\n\n" + table({"cut": (3, 3), "full": (1, 1), "kill": (20, 20)}) + "\nafter\n"


def test_the_page_shows_no_attack_that_succeeded() -> None:
    rows = read(PAGE.read_text())
    assert all(tried == held for tried, held in rows.values()), rows
