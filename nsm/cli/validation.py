"""Validation of composed configurations: types and ranges of settings, and the arguments of every ``_target_``."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pkgutil import resolve_name
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from omegaconf import DictConfig, OmegaConf

from nsm.cli.errors import InputError
from nsm.cli.schema import check_of
from nsm.cli.settings import invalid, nearest, number

#: What omegaconf writes for a value that must be given.
_MISSING = "???"
#: Keys of a ``_target_`` config that are no arguments.
_OWN_KEYS = {"_target_", "_partial_", "_args_", "_recursive_", "_convert_"}
#: Scalar types that a setting may have, as a message calls them.
_NAMES = {bool: "true or false", int: "an integer", float: "a finite number", str: "a text", NoneType: "null"}


def validate(cfg: DictConfig, command: str) -> None:
    """Check all settings of a command before it begins.

    A setting has the type and the range that `nsm.cli.schema` gives it. Any other argument of a ``_target_``, such as
    one of a class outside this package, has the type that the signature says, and all numbers are finite.

    Args:
        cfg: Composed configuration; values that are still missing are left to the command.
        command: Name of the command and of its file in ``conf``.

    Raises:
        InputError: If a value has another type or lies outside its range, or an argument is unknown.
    """
    for name, value in _walk(OmegaConf.to_container(cfg, resolve=True), ""):
        if value == _MISSING:
            continue
        check = check_of(name, command)
        if check is not None:
            check(name, value)
        if isinstance(value, Mapping):
            _require_arguments(name, value, command)
        else:
            _require_finite(name, value)


def _walk(node: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    """All settings with their dotted names, groups before their members."""
    if isinstance(node, Mapping):
        for key, value in node.items():
            yield f"{prefix}{key}", value
            yield from _walk(value, f"{prefix}{key}.")
    elif isinstance(node, list):
        for value in node:
            yield from _walk(value, prefix)


def _require_finite(name: str, value: Any) -> None:
    if isinstance(value, float):
        number(name, value)
    elif isinstance(value, list):
        for entry in value:
            _require_finite(name, entry)


def _require_arguments(name: str, node: Mapping[str, Any], command: str) -> None:
    """Require that a ``_target_`` exists, takes the arguments beside it, and takes values of their types."""
    target = node.get("_target_")
    if not isinstance(target, str) or target == _MISSING:
        return
    hints = _hints(name, target)
    for key, value in node.items():
        if key in _OWN_KEYS or value == _MISSING:
            continue
        if key not in hints and None not in hints:
            known = ", ".join(str(hint) for hint in hints) or "none"
            raise InputError(
                f"`{name}.{key}` must be an argument of {target} ({known}), got an unknown one. "
                f"Try `{_instead(name, str(key), value, node, hints)}`."
            )
        hint = hints.get(key, Any)
        if check_of(f"{name}.{key}", command) is None and not _fits(value, hint):
            raise invalid(f"{name}.{key}", _wanted(hint), value, "VALUE")


def _instead(name: str, key: str, value: Any, node: Mapping[str, Any], hints: Iterable[str | None]) -> str:
    """What to type in place of an unknown argument: that of a group inside, or one with a similar name."""
    inside = [group for group, members in node.items() if isinstance(members, Mapping) and key in members]
    near = f"{inside[0]}.{key}" if inside else nearest(key, map(str, hints))
    return f"{name}.{near}={value}" if near else f"~{name}.{key}"


@cache
def _hints(name: str, target: str) -> dict[str | None, Any]:
    """Annotations of the arguments of a target by name; the key None stands for any other argument that it takes."""
    try:
        function: Callable[..., Any] = resolve_name(target)
        signature = inspect.signature(function)
    except Exception as error:  # whatever the import of a module raises
        raise InputError(
            f"`{name}._target_` must name a class or a function that can be imported, got {target} "
            f"({' '.join(str(error).split())}). Try one of the files in conf/."
        ) from error
    try:
        hints = get_type_hints(function.__init__ if inspect.isclass(function) else function)
    except Exception:  # annotations that cannot be evaluated say nothing
        hints = {}
    named: dict[str | None, Any] = {
        p.name: hints.get(p.name, Any) for p in signature.parameters.values() if p.kind not in _VARIADIC
    }
    open_ended = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in signature.parameters.values())
    return {**named, **({None: Any} if open_ended else {})}


_VARIADIC = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def _fits(value: Any, hint: Any) -> bool:
    """Whether a plain value may be passed where an annotation stands; annotations of other kinds accept anything."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return any(_fits(value, each) for each in arguments)
    if origin is Literal:
        return value in arguments
    if isinstance(value, Mapping) or hint is Any:
        return True
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if hint in _NAMES:
        return type(value) is hint
    if isinstance(value, list):
        sequence = inspect.isclass(origin or hint) and issubclass(origin or hint, Sequence)
        return not sequence or origin is tuple or not arguments or all(_fits(each, arguments[0]) for each in value)
    # a scalar stands for no other object, such as the factory of a network
    return value is not None and not inspect.isclass(origin or hint)


def _wanted(hint: Any) -> str:
    """An annotation in words."""
    if get_origin(hint) in (Union, UnionType):
        return " or ".join(map(_wanted, get_args(hint)))
    return str(_NAMES.get(hint) or getattr(hint, "__name__", hint))
