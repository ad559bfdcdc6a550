"""Explanations of command lines that Hydra rejects, in the form of all other errors."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException, InstantiationException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.cli.groups import Group, describe, group_folders, option_names
from nsm.cli.overrides import names_file, shape_overrides
from nsm.cli.settings import invalid, nearest

#: Flags of Hydra that start with two dashes.
_FLAGS = {
    "--help", "--hydra-help", "--version", "--cfg", "--resolve", "--package", "--run", "--multirun", "--info",
    "--shell-completion", "--config-path", "--config-name", "--config-dir", "--experimental-rerun",
}  # fmt: skip
#: Settings that may be left out with a ``~``.
_LEFT_OUT = re.compile(r"(.+\.)?terms\.\w+|(callbacks|logger|trainer)\.\w+|(source|target)\.pose(\.\w+)?|defaults.*")
#: Overrides that change the set of settings, which unknown names are then compared with.
_CHOICE = re.compile(r"^\+?[\w/]+(@\w+)?=\w+$")


def require_settings(arguments: Sequence[str], command: str) -> None:
    """Refuse what Hydra misunderstands: options with dashes, a name or a file in place of a shape, and lost settings.

    Args:
        arguments: Command line without the program.
        command: Name of the command and of its file in ``conf``.

    Raises:
        InputError: If there is such an argument.
    """
    packages = {group.package: group for group in describe(command).groups if group.package}
    for position, argument in enumerate(arguments):
        name, _, value = argument.partition("=")
        if name.startswith("--") and name not in _FLAGS:
            following = next((a for a in arguments[position + 1 :] if not a.startswith("-")), "VALUE")
            setting = name[2:].replace("-", "_")
            raise InputError(
                f"`{name}` must be a setting without dashes, got an option. Try `{setting}={value or following}`."
            )
        if name in packages and value and not value.startswith("{"):
            suggestion = _choose(packages[name], value)
            raise InputError(f"`{name}` must be chosen from its group, got {value}. Try `{suggestion}`.")
        if value == "{}":
            raise InputError(
                f"`{name}` must hold at least one setting, got {{}}, which changes nothing. Try one of its settings, "
                f"or `~{name}.NAME` to leave one out."
            )
        if name.startswith("~") and not _LEFT_OUT.match(name[1:]) and name[1:] in _settings(command, []):
            raise InputError(
                f"`{name}` must name a loss term, a callback, or a logger, got a setting that `nsm {command}` needs. "
                f"Try `{name[1:]}={_settings(command, [])[name[1:]]}`."
            )


def explain(error: Exception, arguments: Sequence[str], command: str) -> str:
    """Say in one sentence what was wrong with a command line, and what to type instead.

    Args:
        error: Error of Hydra or OmegaConf.
        arguments: Command line without the program.
        command: Name of the command and of its file in ``conf``.
    """
    overrides = [argument for argument in arguments if not argument.startswith("-")]
    message = str(error)
    if isinstance(error, OverrideParseException):
        return _unparsed(error.override, overrides, command)
    if match := re.search(r"Could not find '([\w/]+)/([^'/]+)'", message):
        return _unknown_option(match[1], match[2], overrides)
    if match := re.search(r"Could not override '([^']+)'\.\s+Did you mean to override one of ([^\n?]+)", message):
        known, value = re.split(r",\s*", match[2]), _value(match[1], overrides)
        suggestion = f"{nearest(match[1], known) or known[0]}={value}"
        return f"`{match[1]}` must be {' or '.join(known)}, got {match[1]}={value}. Try `{suggestion}`."
    if match := re.search(r"Could not append to config\. An item is already at '([^']+)'", message):
        value = _value(f"+{match[1]}", overrides)
        return f"`+{match[1]}` must be a new setting, got one that exists. Try `{match[1]}={value}`."
    if match := re.search(r"Could not (?:override|delete from config\.) '([^']+)'", message):
        return _unknown_setting(match[1], overrides, command)
    if match := re.search(r"Ambiguous value for argument '([^']+)'", message):
        name, _, value = match[1].partition("=")
        return (
            f"`{name}` must be one value, got {value}. Try `{name}=[{value}]` for a list, or add `--multirun` to run "
            "the command once for each."
        )
    if match := re.search(r"Missing mandatory value: \w+\s+full_key: (\S+)", message):
        return f"`{match[1]}` must be given, got nothing. Try `{match[1]}={_example(match[1])}`."
    if match := re.search(r"node `([^`]+)` is not a container", message):
        value = _value(match[1], overrides)
        return f"`{match[1]}` must be a group of settings, got {value}. Try one of its settings (`{_help(command)}`)."
    if isinstance(error, InstantiationException):
        return _uninstantiated(error, command)
    if match := re.search(r"nterpolation key '([^']+)' not found\s+full_key: (\S+)", message):
        return f"`{match[2]}` must refer to an existing setting, got ${{{match[1]}}}. Try `{_help(command)}`."
    return f"The configuration must compose, got: {' '.join(message.split())}. Try `{_help(command)}`."


def _uninstantiated(error: InstantiationException, command: str) -> str:
    """The sentence for a ``_target_`` that refuses its arguments."""
    message = " ".join(str(error.__cause__ or error).split())
    match = re.search(r"full_key: (\S+)", str(error))
    name = match[1] if match else "_target_"
    return f"`{name}` must have settings that fit together, got: {message.rstrip('.')}. Try `{_help(command)}`."


def _unparsed(argument: str, overrides: Sequence[str], command: str) -> str:
    """The sentence for an argument outside Hydra's grammar."""
    name, equals, value = argument.partition("=")
    if equals:
        return (
            f"`{name}` must be quoted where it holds spaces, brackets, or signs such as = and :, got {value}. "
            f"""Try `"{name}='{value.strip(chr(39))}'"`."""
        )
    packages = [group.package for group in describe(command).groups if group.package]
    if names_file(argument):
        if not packages:
            return f"`{argument}` must be given to a setting, got it alone. Try `checkpoint={argument}`."
        bare = [override for override in overrides if "=" not in override]
        side = packages[min(bare.index(argument) if argument in bare else 0, len(packages) - 1)]
        suggestion = " ".join(shape_overrides(side, argument))
        return f"`{argument}` must be given to a shape, got it alone. Try `{suggestion}`."
    known = _settings(command, [])
    found = argument if argument in known else nearest(argument, known)
    suggestion = f"{found}={known[found]}" if found else _help(command)
    return f"`{argument}` must have the form setting=value, got no value. Try `{suggestion}`."


def _unknown_option(folder: str, option: str, overrides: Sequence[str]) -> str:
    """The sentence for a group without such an option."""
    typed = next((o.partition("=")[0] for o in overrides if o.endswith(f"={option}")), folder)
    known = option_names(folder)
    package = typed.partition("@")[2]
    if package and names_file(option):
        suggestion = " ".join(shape_overrides(package, option))
        return f"`{typed}` must be the name of an option, got a file. Try `{suggestion}`."
    near = nearest(option, known) or (known[0] if known else "NAME")
    among = f"one of {', '.join(known)}" if known else "the name of an option"
    return str(invalid(typed, among, option, near))


def _unknown_setting(name: str, overrides: Sequence[str], command: str) -> str:
    """The sentence for a setting that is not there."""
    value = _value(name, overrides)
    description = describe(command)
    packages = {group.package: group for group in description.groups if group.package}
    if name in group_folders():
        return f"`{name}` must be added with a plus, got none. Try `+{name}={value}`."
    parent, _, last = name.rpartition(".")
    if parent in packages and last == "path":
        suggestion = " ".join(shape_overrides(parent, value))
        return f"`{name}` must belong to a shape that is read from a file, got another shape. Try `{suggestion}`."
    known = _settings(command, overrides)
    siblings = {key for key in known if key.rpartition(".")[0] == parent}
    folders = {group.folder: group for group in description.groups}
    near = nearest(name, siblings) or (nearest(name, folders) if not parent else None)
    near = near or _same_leaf(last, known) or nearest(name, known)
    suggestion = f"{folders[near].typed if near in folders else near}={value}" if near else _help(command)
    return f"`{name}` must be a setting of `nsm {command}`, got an unknown name. Try `{suggestion}`."


def _same_leaf(last: str, known: dict[str, Any]) -> str | None:
    """The setting with this last part of its name, if there is exactly one."""
    found = [key for key in known if key.rpartition(".")[2] == last]
    return found[0] if len(found) == 1 else None


def _choose(group: Group, value: str) -> str:
    """The override that chooses what was meant by a value: an option by name, or a file."""
    if names_file(value):
        return " ".join(shape_overrides(str(group.package), value))
    return f"{group.typed}={nearest(value, group.option_names) or group.chosen}"


def _value(name: str, overrides: Sequence[str]) -> str:
    """The value that was typed for a name."""
    found = (o.partition("=")[2] for o in overrides if o.partition("=")[0].lstrip("~") == name)
    return next(found, "") or "VALUE"


def _settings(command: str, overrides: Sequence[str]) -> dict[str, Any]:
    """All settings of a command by dotted name, with those of the chosen options where these compose."""
    choices = [override for override in overrides if _CHOICE.match(override)]
    for chosen in ([o for o in choices if o.partition("=")[0].strip("+").partition("@")[0] in group_folders()], []):
        GlobalHydra.instance().clear()
        with initialize_config_dir(str(CONF), version_base="1.3"):
            try:
                cfg = compose(command, chosen)
            except (HydraException, OmegaConfBaseException):
                continue
        return dict(_flat(cfg, ""))
    return {}


def _flat(cfg: DictConfig, prefix: str) -> Iterator[tuple[str, Any]]:
    for key in map(str, cfg):
        name = prefix + key
        value = None if OmegaConf.is_missing(cfg, key) else cfg._get_node(key)
        if isinstance(value, DictConfig) and not value._is_none() and not value._is_missing():
            yield from _flat(value, f"{name}.")
        else:
            yield name, value


def _example(name: str) -> str:
    return "FILE" if name.endswith("path") else "VALUE"


def _help(command: str) -> str:
    return f"nsm {command} --help"
