"""The instantiator of ``_target_`` configs that come from outside, such as from a checkpoint.

A configuration that the user composed is instantiated by Hydra, which may call anything. What stands in a file may
come from a stranger, so here a ``_target_`` is checked before it is called: it must be a class of this package, of the
kind that is wanted.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping
from functools import partial
from typing import Any

from torch import nn

from nsm.cli.errors import InputError


def build(node: Any, kind: type = nn.Module) -> Any:
    """Instantiate nested ``_target_`` configs.

    Args:
        node: Nested mappings and lists of plain values. A mapping with ``_target_`` becomes an instance of that class,
            called with the other entries, or a `functools.partial` of it if ``_partial_`` is true.
        kind: Class of which every target must be a subclass.

    Returns:
        The same structure with instances in place of such mappings.

    Raises:
        InputError: If a target is not such a class of this package. In that case nothing has been called.

    Example:
        >>> build({"_target_": "nsm.fields.Gaussian", "alpha": 0.1}).alpha
        0.1
    """
    _require_known(node, kind)
    return _make(node, kind)


def _require_known(node: Any, kind: type) -> None:
    if isinstance(node, Mapping):
        if "_target_" in node:
            _class_of(node["_target_"], kind)
        for value in node.values():
            _require_known(value, kind)
    elif isinstance(node, list):
        for value in node:
            _require_known(value, kind)


def _make(node: Any, kind: type) -> Any:
    if isinstance(node, Mapping):
        arguments = {key: _make(value, kind) for key, value in node.items() if key not in ("_target_", "_partial_")}
        if "_target_" not in node:
            return arguments
        made = _class_of(node["_target_"], kind)
        return partial(made, **arguments) if node.get("_partial_") else made(**arguments)
    if isinstance(node, list):
        return [_make(value, kind) for value in node]
    return node


def _class_of(target: Any, kind: type) -> type:
    module, _, name = str(target).rpartition(".")
    found: Any = None
    if module == "nsm" or module.startswith("nsm."):
        try:
            found = getattr(importlib.import_module(module), name, None)
        except ImportError:
            found = None
    ours = inspect.isclass(found) and issubclass(found, kind) and found.__module__.startswith("nsm.")
    # classes that read, or download, a file name it `path`
    if not ours or "path" in inspect.signature(found).parameters:
        raise InputError(
            f"`_target_` must be a {kind.__name__} of nsm that reads no other file, got {target!r}. Try the name of a "
            "class in conf/; do not use this file if someone else wrote it."
        )
    return found
