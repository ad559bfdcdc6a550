"""Broken settings: every setting of every command with values that no setting of its kind should take."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, OmegaConf

from nsm.cli.configuration import CONF
from nsm.cli.groups import describe

COMMANDS = ("train", "evaluate", "export", "render", "view", "compare")
#: What is typed in place of a value.
HOSTILE = ("nan", "inf", "-1", "0", "1e30", "foo", "true", "[]", "{}", "null", "''", "[nan,1]", "{a:1}")

#: Settings for which a hostile value is a good one, by patterns of names. Written down by hand: what the code accepts
#: beyond this list is accepted silently.
GOOD: dict[str, str] = {
    "-1": r".*\.(start|stop)|.*offset|turns|level|velocity\.scale|trainer\.(devices|max_epochs)|.*\.label"
    r"|.*pose\.rotation",
    "0": r".*\.(weight|alpha|weight_decay|floor|warmup|start|stop|decay|fraction|own|visitors|surface|ambient|label)"
    r"|seed|sdf\.seed|slices\.changes|.*offset|turns|level|hold|velocity\.scale|trainer\.(max_epochs|num_sanity_val_steps)"
    r"|.*pose\.rotation",
    "null": r".*\.(pose|pose\.rotation|pose\.translation|up|fit|label|spacing|threshold|first_omega)|threads"
    r"|callbacks\.strip\.times|logger\.wandb\.group"
    r"|source\.omega|target\.omega|landmarks\.\w+_vertices|trainer\.(check_val_every_n_epoch|gradient_clip_val)"
    r"|checkpoint|official|output|format|advect|mesh|port|record|growth\.(source|target|_target_)|.*_target_"
    r"|compare:(steps|minutes|learning_rates)",
    "''": r"logger\.\w+\.(name|version)",
    "[]": r"compare:(overrides|pairs|methods)|timing\.pairs|logger\.wandb\.tags",
    "true": r"equal_volume|resume|exact_volume|advect|project|back|open_browser|official|retry|.*_partial_"
    r"|trainer\.enable_model_summary|logger\.wandb\.offline",
    "foo": r"(train|compare):name|.*\.(path|folder|save_dir|name|version|source_mesh|target_mesh|project|group)"
    r"|trainer\.strategy|checkpoint|official|output|format|mesh|color|host|record",
}


class Case(NamedTuple):
    """One hostile value for one setting."""

    command: str
    choices: tuple[str, ...]
    name: str
    value: str

    @property
    def good(self) -> bool:
        """Whether the value is one that the setting may have."""
        pattern = GOOD.get(self.value)
        names = (self.name, f"{self.command}:{self.name}")
        return pattern is not None and any(re.fullmatch(pattern, name) for name in names)


def cases(choices_of: Callable[[str], list[tuple[str, ...]]]) -> list[Case]:
    """All of them, in a fixed order.

    Args:
        choices_of: Choices of groups to look for settings in, for each command.
    """
    return [
        Case(command, choices, name, value)
        for command in COMMANDS
        for name, choices in sorted(_settings(command, choices_of(command)).items())
        for value in HOSTILE
    ]


def defaults(command: str) -> list[tuple[str, ...]]:
    """The default choices alone."""
    return [()]


def everything(command: str) -> list[tuple[str, ...]]:
    """The default choices, and each option of each group."""
    groups = [group for group in describe(command).groups if not group.added]
    return [(), *((f"{group.typed}={option}",) for group in groups for option in group.option_names)]


@cache
def composed(command: str, overrides: tuple[str, ...]) -> DictConfig:
    """The configuration of a command, with Hydra's own part."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose(command, list(overrides), return_hydra_config=True)


def _settings(command: str, choices: list[tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """All settings of a command, each with the choices of groups that bring it."""
    found: dict[str, tuple[str, ...]] = {}
    for chosen in choices:
        for name in _leaves(composed(command, chosen), ""):
            found.setdefault(name, chosen)
    return found


def _leaves(node: DictConfig, prefix: str) -> Iterator[str]:
    """Dotted names of the values that are no groups, but for the names of classes."""
    for key in map(str, node):
        value: Any = node._get_node(key)
        if not prefix and key == "hydra":
            continue
        if isinstance(value, DictConfig) and not value._is_none() and not value._is_missing():
            yield from _leaves(value, f"{prefix}{key}.")
        elif not OmegaConf.is_missing(node, key) and key not in ("_target_", "_partial_", "kind"):
            yield f"{prefix}{key}"
