"""Validation of settings: each function returns a valid value, or raises an `InputError` that says what to type.

Every message has the same form: "`steps` must be a positive integer, got 0. Try `steps=3900`."
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from nsm.cli.errors import InputError

#: Largest number of any setting; its square still fits into single precision.
_LARGEST = 1e18
#: Largest number of times that `morph_times` spreads from 0 to 1.
_MOST_TIMES = 100_000


def invalid(name: str, requirement: str, value: Any, example: Any) -> InputError:
    """The error for a setting with an invalid value, ready to be raised.

    >>> str(invalid("beta.alpha", "positive", -1, 0.1))
    '`beta.alpha` must be positive, got -1. Try `beta.alpha=0.1`.'

    Args:
        name: Dotted name of the setting.
        requirement: Completion of "must be".
        value: The value received.
        example: A valid value to type instead.
    """
    return InputError(f"`{name}` must be {requirement}, got {_shown(value)}. Try `{name}={example}`.")


def whole_number(name: str, value: Any, least: int = 1, example: int | None = None, most: int | None = None) -> int:
    """Return an integer of at least ``least`` and at most ``most``.

    Args:
        name: Dotted name of the setting.
        value: Value of the setting.
        least: Smallest valid value.
        example: Value to suggest, ``least`` by default.
        most: Largest valid value; None sets no limit.

    Raises:
        InputError: If the value is not such an integer.
    """
    suggested = least if example is None else example
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        requirement = "a positive integer" if least == 1 else f"an integer of at least {least}"
        raise invalid(name, requirement, value, suggested)
    if most is not None and value > most:
        raise invalid(name, f"an integer of at most {most}", value, min(suggested, most))
    return value


def number(name: str, value: Any, example: float = 0.5) -> float:
    """Return a finite number.

    Raises:
        InputError: If the value is not one.
    """
    if not _is_number(value):
        raise invalid(name, "a finite number", value, example)
    return float(value)


def positive(name: str, value: Any, example: float = 1.0) -> float:
    """Return a finite number greater than 0.

    Raises:
        InputError: If the value is not one.
    """
    if not _is_number(value) or value <= 0:
        raise invalid(name, "positive and finite", value, f"{example:g}")
    return float(value)


def at_least(name: str, value: Any, least: float, example: float) -> float:
    """Return a finite number that is not less than ``least``.

    Raises:
        InputError: If the value is not one.
    """
    if not _is_number(value) or value < least:
        raise invalid(name, f"a finite number of at least {least:g}", value, f"{example:g}")
    return float(value)


def up_to(name: str, value: Any, most: float, example: float) -> float:
    """Return a number greater than 0 and at most ``most``.

    Raises:
        InputError: If the value is not one.
    """
    if not _is_number(value) or not 0 < value <= most:
        raise invalid(name, f"a number above 0 and at most {most:g}", value, f"{example:g}")
    return float(value)


def between(name: str, value: Any, low: float, high: float, example: float) -> float:
    """Return a number strictly between ``low`` and ``high``.

    Raises:
        InputError: If the value is not one.
    """
    if not _is_number(value) or not low < value < high:
        raise invalid(name, f"a number between {low:g} and {high:g}", value, f"{example:g}")
    return float(value)


def fraction(name: str, value: Any, example: float = 0.5) -> float:
    """Return a number from 0 to 1, both included.

    Raises:
        InputError: If the value is not one.
    """
    if not _is_number(value) or not 0 <= value <= 1:
        raise invalid(name, "a number from 0 to 1", value, f"{example:g}")
    return float(value)


def numbers(name: str, value: Any, lengths: Sequence[int] | None = None, example: str = "[1,2]") -> list[Any]:
    """Return a list of finite numbers.

    Args:
        name: Dotted name of the setting.
        value: Value of the setting.
        lengths: Valid lengths of the list; None accepts any.
        example: Value to suggest.

    Raises:
        InputError: If the value is not such a list.
    """
    if not isinstance(value, list) or not all(_is_number(entry) for entry in value):
        raise invalid(name, "a list of numbers", value, example)
    if lengths is not None and len(value) not in lengths:
        raise invalid(name, f"a list of {' or '.join(map(str, lengths))} numbers", value, example)
    return value


def text(name: str, value: Any) -> str:
    """Return a text that is not empty.

    Raises:
        InputError: If the value is not one.
    """
    if not isinstance(value, str) or not value:
        raise invalid(name, "a text that is not empty", value, f"'{_shown(value)}'" if value else "NAME")
    return value


def increasing(name: str, values: Sequence[float], example: str = "[0,0.5,1]") -> list[float]:
    """Return numbers in strictly increasing order.

    Raises:
        InputError: If they are in another order, or not finite.
    """
    given = list(values)
    if not all(map(_is_number, given)) or not all(a < b for a, b in pairwise(given)):
        raise invalid(name, "a list of increasing numbers", given, example)
    return [float(entry) for entry in given]


def switch(name: str, value: Any) -> bool:
    """Return true or false.

    Raises:
        InputError: If the value is neither.
    """
    if not isinstance(value, bool):
        raise invalid(name, "true or false", value, "true")
    return value


def choice(name: str, value: Any, known: Iterable[str]) -> str:
    """Return one of some names.

    >>> choice("color", "cley", ["clay", "position"])
    Traceback (most recent call last):
    nsm.cli.errors.InputError: `color` must be one of clay, position, got cley. Try `color=clay`.

    Raises:
        InputError: If the value is none of them; the message suggests the nearest one.
    """
    names = list(known)
    if value not in names:
        raise invalid(name, f"one of {', '.join(names)}", value, nearest(str(value), names) or names[0])
    return str(value)


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The name most similar to another, or None if no name is similar.

    >>> nearest("stepps", ["seed", "steps"])
    'steps'
    """
    names = {known_name.lower(): known_name for known_name in known}
    found = difflib.get_close_matches(name.lower(), names, n=1)
    return names[found[0]] if found else None


def morph_time(name: str, value: Any) -> float:
    """Return a time of a morph, a number from 0 to 1.

    Raises:
        InputError: If the value is not one.
    """
    return fraction(name, value)


def morph_times(name: str, value: Any) -> list[float]:
    """Return times of a morph, given as a list or as a number of times, evenly spaced from 0 to 1.

    Raises:
        InputError: If the value is neither.
    """
    if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= _MOST_TIMES:
        import torch  # not above: help and completion of the shell must not wait for it

        return torch.linspace(0, 1, value, dtype=torch.double).tolist()
    if isinstance(value, list) and value and all(_is_number(entry) and 0 <= entry <= 1 for entry in value):
        return [float(entry) for entry in value]
    raise InputError(
        f"`{name}` must be a number of times or a list of times from 0 to 1, got {_shown(value)}. "
        f"Try `{name}=24` or `{name}=[0,0.5,1]`."
    )


def use_threads(config: Mapping[str, Any]) -> None:
    """Limit torch to the ``threads`` of a configuration; None leaves the number to torch."""
    if config["threads"] is not None:
        import torch

        torch.set_num_threads(config["threads"])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _LARGEST


def _shown(value: Any) -> str:
    """A value as it is typed."""
    return "nothing" if value is None else f"{value}".replace("'", "")
