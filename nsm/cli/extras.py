"""Optional dependencies, with one sentence that names the missing package and the extra that installs it."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from nsm.cli.errors import InputError


def require(module: str, purpose: str, extra: str, package: str | None = None) -> Any:
    """Import an optional dependency.

    Args:
        module: Name to import, such as ``nibabel``.
        purpose: What needs it, as the beginning of a sentence: ``Reading .nii``.
        extra: Extra of nsm that installs it.
        package: Name of the package where it differs from ``module``.

    Returns:
        The module.

    Raises:
        InputError: If it is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise InputError(
            f"{purpose} needs `{package or module}`, which is not installed. Try `pip install 'nsm[{extra}]'`."
        ) from error
