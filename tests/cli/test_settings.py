"""Validation of settings: valid values pass unchanged, anything else is refused in one form."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest

from nsm.cli import settings
from nsm.cli.errors import InputError

TEMPLATE = re.compile(r"^`[\w.]+` must be .+, got .+\. Try `.+`\.$")


@pytest.mark.parametrize(
    ("check", "arguments", "value"),
    [
        (settings.whole_number, (1,), 1),
        (settings.number, (), -0.5),
        (settings.positive, (), 1e-9),
        (settings.between, (0, 1, 0.5), 0.25),
        (settings.fraction, (), 0),
        (settings.fraction, (), 1),
        (settings.numbers, (), [1, 2.5]),
        (settings.increasing, (), [0.0, 0.5, 1.0]),
        (settings.switch, (), False),
        (settings.choice, (["a", "b"],), "b"),
        (settings.morph_times, (), [0.0, 1.0]),
    ],
)
def test_valid_values_pass_unchanged(check: Any, arguments: tuple[Any, ...], value: Any) -> None:
    assert check("name", value, *arguments) == value


@pytest.mark.parametrize(
    ("check", "arguments", "value", "requirement"),
    [
        (settings.whole_number, (1,), 0, "a positive integer"),
        (settings.whole_number, (1,), True, "a positive integer"),
        (settings.whole_number, (8,), 7, "an integer of at least 8"),
        (settings.whole_number, (1,), 1.5, "a positive integer"),
        (settings.number, (), math.nan, "a finite number"),
        (settings.number, (), "much", "a finite number"),
        (settings.positive, (), 0, "positive and finite"),
        (settings.positive, (), math.inf, "positive and finite"),
        (settings.between, (0, 1, 0.5), 1, "a number between 0 and 1"),
        (settings.fraction, (), 1.01, "a number from 0 to 1"),
        (settings.fraction, (), None, "a number from 0 to 1"),
        (settings.numbers, (), [1, "b"], "a list of numbers"),
        (settings.increasing, (), [0.0, 0.0], "a list of increasing numbers"),
        (settings.switch, (), "yes", "true or false"),
        (settings.choice, (["clay", "position"],), "cley", "one of clay, position"),
        (settings.morph_times, (), [0.0, 2.0], "a number of times or a list of times from 0 to 1"),
        (settings.morph_times, (), 0, "a number of times or a list of times from 0 to 1"),
    ],
)
def test_invalid_values_are_refused_in_one_form(
    check: Any, arguments: tuple[Any, ...], value: Any, requirement: str
) -> None:
    with pytest.raises(InputError) as refusal:
        check("group.name", value, *arguments)
    said = str(refusal.value)
    assert TEMPLATE.match(said), said
    assert said.startswith(f"`group.name` must be {requirement}, got ")


def test_a_number_of_times_is_spread_evenly() -> None:
    assert settings.morph_times("times", 5) == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert settings.morph_times("times", 1) == [0.0]


def test_the_nearest_name_is_suggested() -> None:
    assert settings.nearest("Adadif", ["free", "adadiv", "nulldiv"]) == "adadiv"
    assert settings.nearest("xyz", ["free", "adadiv"]) is None
