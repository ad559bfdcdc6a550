"""Timings by name and from configurations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from omegaconf import OmegaConf

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.cli.groups import option_names
from nsm.cli.settings import choice
from nsm.io.build import build
from nsm.morphs.timing import Table, Timing

#: A timing as users give it: the name of a file in ``conf/timing``, or pairs of film time and time of the morph.
TimingLike = str | Sequence[Sequence[float]]
#: The timing that needs pairs, so that its name alone says nothing.
_TABLE = "table"


def build_timing(config: Mapping[str, Any]) -> Timing | None:
    """Instantiate the timing of a configuration; None for the morph's own time (``timing=linear``).

    Args:
        config: ``_target_``, a subclass of `Timing`, and its arguments (``conf/timing``).

    Raises:
        InputError: If the target is not a timing, or does not take these arguments.
    """
    if config["_target_"] is None:
        return None
    try:
        return build(config, Timing)
    except TypeError as error:
        raise InputError(
            f"`timing` must have the arguments of {config['_target_']}, got others ({error}). Try `timing=smooth`."
        ) from error


def read_timing(value: TimingLike) -> Timing | None:
    """Read a timing that a user gives; None for the morph's own time, ``linear``.

    Raises:
        InputError: If there is no timing of this name, or the pairs are not those of a `Table`.

    Example:
        >>> read_timing("smooth")(0.25), read_timing([[0, 0], [0.5, 0.2], [1, 1]])(0.5)
        (0.15625, 0.2)
    """
    if not isinstance(value, str):
        return Table(value)
    name = choice("timing", value, [option for option in option_names("timing") if option != _TABLE])
    config: Any = OmegaConf.to_container(OmegaConf.load(CONF / "timing" / f"{name}.yaml"))
    return build_timing(config)
