"""Checks of settings that are more than one number: groups, lists, and alternatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from nsm.cli.errors import InputError
from nsm.cli.settings import increasing, invalid, numbers, positive, whole_number

#: Checks the value of a setting, given its dotted name, and raises an `InputError`.
Check = Callable[[str, Any], object]

#: Most threads of a process; torch ends with a segmentation fault at some number above.
MOST_THREADS = 1024


def optional(check: Check) -> Check:
    """Accept null as well."""

    def checked(name: str, value: Any) -> object:
        return None if value is None else check(name, value)

    return checked


def either(first: Check, second: Check) -> Check:
    """Accept what one of two checks accepts; the first tells what is wrong."""

    def checked(name: str, value: Any) -> object:
        try:
            return first(name, value)
        except InputError:
            try:
                return second(name, value)
            except InputError:
                pass
            raise

    return checked


def section(name: str, value: Any) -> object:
    """Accept a group of settings."""
    if not isinstance(value, Mapping):
        raise InputError(
            f"`{name}` must be a group of settings, got {value}. Try one of its settings, or leave `{name}` out."
        )
    return value


def filled(name: str, value: Any) -> object:
    """Accept a group of at least one setting."""
    if not isinstance(value, Mapping) or not value:
        raise InputError(f"`{name}` must hold at least one entry, got none. Try to leave `{name}` out.")
    return value


def any_list(name: str, value: Any) -> object:
    """Accept a list, also an empty one."""
    if not isinstance(value, list):
        raise invalid(name, "a list", value, f"[{value}]")
    return value


def names(name: str, value: Any) -> object:
    """Accept a name or a path, or a list of them."""
    if not isinstance(value, str | list) or not value or not all(isinstance(each, str) for each in value):
        raise invalid(name, "a name, a path, or a list of them", value, "outputs/demo")
    return value


def any_text(name: str, value: Any) -> object:
    """Accept a text, also an empty one, as loggers of Lightning take it for no folder."""
    if not isinstance(value, str):
        raise invalid(name, "a text", value, f"'{value}'")
    return value


def labels(name: str, value: Any) -> object:
    """Accept an integer or a list of integers."""
    given = entries(name, value) if isinstance(value, list) else [value]
    return [whole_number(name, label, -(2**31), 1, 2**31) for label in given]


def rotation(name: str, value: Any) -> object:
    """Accept an angle, a vector, or a matrix."""
    rows = value if isinstance(value, list) else [value]
    return [numbers(name, row if isinstance(row, list) else [row], example="[0,0,90]") for row in rows]


def points(name: str, value: Any, lengths: Sequence[int] = (2, 3)) -> object:
    """Accept a list of points in the plane or in space."""
    return [numbers(name, point, lengths, "[[0,0],[1,0],[0,1]]") for point in entries(name, value)]


def rates(name: str, value: Any) -> object:
    """Accept a list of different positive numbers."""
    if not isinstance(value, list) or not value or len(set(map(str, value))) < len(value):
        raise invalid(name, "a list of different learning rates", value, "[5e-4,1e-3,2e-3]")
    return [positive(name, rate, 1e-3) for rate in value]


def entries(name: str, value: Any) -> list[Any]:
    """Return a list that is not empty."""
    if not isinstance(value, list) or not value:
        raise invalid(name, "a list that is not empty", value, "[…]")
    return value


def rising(name: str, value: Any) -> object:
    """Accept a list of increasing numbers."""
    return increasing(name, numbers(name, value, example="[0,0.5,1]"))


def frequencies(name: str, value: Any) -> object:
    """Accept a positive number or a list of positive numbers."""
    return [positive(name, each, 30.0) for each in (entries(name, value) if isinstance(value, list) else [value])]


def betas(name: str, value: Any) -> object:
    """Accept the decay rates of an optimizer, each in [0, 1)."""
    for beta in numbers(name, value, (2, 3), "[0.9,0.999]"):
        if not 0 <= beta < 1:
            raise invalid(name, "a list of numbers from 0 to below 1", value, "[0.9,0.999]")
    return value


def devices(name: str, value: Any) -> object:
    """Accept what Lightning takes for devices: auto, -1 for all, a number, or a list of indices."""
    if value in ("auto", -1):
        return value
    if isinstance(value, list):
        return [whole_number(name, device, 0, most=MOST_THREADS) for device in entries(name, value)]
    return whole_number(name, value, most=MOST_THREADS)
