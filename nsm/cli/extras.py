"""Optional packages: what is said when one that a task needs is not installed."""

from __future__ import annotations

from importlib.util import find_spec

from nsm.cli.errors import InputError


class MissingPackageError(InputError):
    """A package of an extra is not installed."""


def require(*packages: str, extra: str, task: str) -> None:
    """Check that packages are installed before they are imported.

    Args:
        packages: Names by which they are imported.
        extra: Extra of ``pyproject.toml`` that installs them.
        task: What needs them, as the subject of the sentence.

    Raises:
        MissingPackageError: If one of them is not installed.

    Example:
        >>> require("json", extra="all", task="Reading settings")
        >>> require("no_such_package", extra="all", task="Reading settings")  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        nsm.cli.extras.MissingPackageError: Reading settings needs `no_such_package`, which is not installed. Try ...
    """
    for package in packages:
        if find_spec(package) is None:
            raise MissingPackageError(
                f"{task} needs `{package}`, which is not installed. Try `pip install 'nsm[{extra}]'`."
            )
