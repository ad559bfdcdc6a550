"""What people type as settings of a command, read into values or refused in one sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch

from nsm.cli.errors import InputError


def whole_number(name: str, value: Any, least: int) -> int:
    """A setting that must be a whole number of at least ``least``.

    Raises:
        InputError: if it is not.
    """
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise InputError(f"{name}={value} cannot be: give a whole number of at least {least}")
    return value


def number(name: str, value: Any) -> float:
    """A setting that must be a number.

    Raises:
        InputError: if it is not.
    """
    if not _is_number(value):
        raise InputError(f"{name}={value} is no number: give one such as {name}=0.5")
    return float(value)


def positive(name: str, value: Any) -> float:
    """A setting that must be a finite number above 0.

    Raises:
        InputError: if it is not.
    """
    if not _is_number(value) or not 0 < value < math.inf:
        raise InputError(f"{name}={value} cannot be: give a number above 0")
    return float(value)


def numbers(name: str, value: Any) -> list[Any]:
    """A setting that must be a list of numbers.

    Raises:
        InputError: if it is not.
    """
    if not isinstance(value, list) or not all(_is_number(entry) for entry in value):
        raise InputError(f"{name}={value} is no list of numbers: give one such as {name}=[1,2]")
    return value


def switch(name: str, value: Any) -> bool:
    """A setting that is on or off.

    Raises:
        InputError: if it is neither.
    """
    if not isinstance(value, bool):
        raise InputError(f"{name}={value} is neither on nor off: give {name}=true or {name}=false")
    return value


def moment(name: str, value: Any) -> float:
    """A setting that is a time of a morph.

    Raises:
        InputError: if it is no number from 0 to 1.
    """
    if not _is_number(value) or not 0 <= value <= 1:
        raise InputError(f"{name}={value} is no time of a morph: give a number from 0 to 1, such as {name}=0.5")
    return float(value)


def moments(name: str, value: Any) -> list[float]:
    """A setting that is a list of times of a morph, or how many there are, evenly from 0 to 1.

    Raises:
        InputError: if it is neither.
    """
    if isinstance(value, int) and not isinstance(value, bool) and value >= 1:
        return torch.linspace(0, 1, value, dtype=torch.double).tolist()
    if isinstance(value, list) and value and all(_is_number(entry) and 0 <= entry <= 1 for entry in value):
        return [float(entry) for entry in value]
    raise InputError(
        f"{name}={value} names no times: give how many, such as {name}=24, or a list of numbers from 0 to 1 such as "
        f"{name}=[0,0.5,1]"
    )


def use_threads(config: Mapping[str, Any]) -> None:
    """Let torch use ``threads`` threads of the processor; as many as it likes where that is None.

    Raises:
        InputError: if it is no whole number of at least 1.
    """
    if config["threads"] is not None:
        torch.set_num_threads(whole_number("threads", config["threads"], 1))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
