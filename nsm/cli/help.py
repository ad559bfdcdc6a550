"""Short help of a command: its purpose, three examples, its groups with their options, and its settings."""

from __future__ import annotations

import textwrap

from nsm.cli.groups import Description, Group, Setting, describe

_WIDTH = 80
_INDENT = 4


def command_help(command: str) -> str:
    """Compose the help of a command from the comments of its YAML file.

    Args:
        command: Name of the command and of its file in ``conf``.
    """
    description = describe(command)
    return "\n".join([*_head(command, description), *_groups(description.groups), *_settings(description.settings)])


def _head(command: str, description: Description) -> list[str]:
    usage = f"usage: nsm {command} [SETTING=VALUE ...]"
    lines = [usage, "", *textwrap.wrap(description.purpose, _WIDTH)]
    if description.examples:
        lines += ["", "Examples:", *(f"  {example}" for example in description.examples)]
    return lines


def _groups(groups: list[Group]) -> list[str]:
    lines = ["", "Choices, as in `GROUP=OPTION`; * marks the default:"] if groups else []
    listed = set()
    for group in groups:
        lines += [f"  {group.typed}", *_block(group.says)]
        if group.folder in listed or len(group.option_names) == 1:
            continue
        listed.add(group.folder)
        shown = (f"*{name}" if name == group.chosen and not group.added else name for name in group.option_names)
        lines += _block(", ".join(shown))
    return lines


def _settings(settings: list[Setting]) -> list[str]:
    lines = ["", "Settings, with their defaults:"] if settings else []
    for setting in settings:
        plain = setting.default and "${" not in setting.default
        lines += [f"  {setting.name}={setting.default}" if plain else f"  {setting.name}", *_block(setting.says)]
    return [
        *lines,
        "",
        "`--cfg job` prints the whole configuration, `--multirun` runs every",
        'combination of comma-separated values, and `eval "$(nsm -sc install=bash)"`',
        "completes settings with Tab.",
    ]


def _block(text: str) -> list[str]:
    indent = " " * _INDENT
    return textwrap.wrap(text, _WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)
