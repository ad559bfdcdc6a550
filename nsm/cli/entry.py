"""Entry of every command: composed configuration in, exit status and one-sentence errors out."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial, wraps
from types import FrameType

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console
from rich.markup import escape

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.cli.explain import explain, require_settings
from nsm.cli.files import DISK_ERRORS
from nsm.cli.help import command_help
from nsm.cli.validation import validate

#: Exit status of a command that cannot do what was asked.
REFUSED = 2
#: Settings that take one name or several; several need only commas, without the brackets of a list.
_NAMES = ("checkpoint", "official")


def run(main: Callable[[DictConfig], None], command: str) -> None:
    """Run a command with its composed configuration, or print its help.

    An `InputError`, an error of the configuration, or a folder that cannot be written prints one sentence and exits
    with status 2. Anything else is a defect and keeps its traceback. In a multirun the remaining runs continue.

    Args:
        main: Command, called with the read-only configuration.
        command: Name of the command and of its file in ``conf``.
    """
    arguments = sys.argv[1:]
    if {"-h", "--help"} & set(arguments):
        Console(highlight=False, markup=False, soft_wrap=True).print(command_help(command))
        return
    os.environ["HYDRA_FULL_ERROR"] = "1"  # otherwise Hydra prints the traceback itself and exits
    _silence_lightning()
    report = partial(_report, arguments=arguments, command=command)
    refused: list[str] = []

    @wraps(main)
    def guarded(cfg: DictConfig) -> None:
        try:
            validate(cfg, command)
            main(cfg)
        except Exception as error:
            refused.append(report(error))

    try:
        require_settings(arguments, command)
        if not {"-m", "--multirun"} & set(arguments):
            sys.argv[1:] = [_as_list(argument) for argument in arguments]
        with _cleaning_up_when_terminated():
            hydra.main(config_path=str(CONF), config_name=command, version_base="1.3")(guarded)()
    except Exception as error:
        refused.append(report(error))
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    if refused:
        sys.exit(REFUSED)


def run_plain(main: Callable[[list[str]], None], command: str) -> None:
    """Run a command that parses its own arguments, with the errors and exit codes of `run`.

    Args:
        main: Command, called with the command line after its name.
        command: Name of the command.
    """
    _silence_lightning()
    try:
        with _cleaning_up_when_terminated():
            main(sys.argv[1:])
    except Exception as error:
        _report(error, sys.argv[1:], command)
        sys.exit(REFUSED)
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)


def _as_list(argument: str) -> str:
    """Turn ``checkpoint=a,b`` into ``checkpoint=[a,b]``, and leave other arguments as they are."""
    name, _, value = argument.partition("=")
    several = name in _NAMES and "," in value and value[0] not in "[\"'"
    return f"{name}=[{value}]" if several else argument


def _report(error: Exception, arguments: Sequence[str], command: str) -> str:
    """Print the sentence of an error and return it, or raise the error again if it is a defect."""
    sentence = _sentence(error, arguments, command)
    if sentence is None:
        raise error
    Console(stderr=True, soft_wrap=True).print(f"[bold red]nsm:[/] {escape(sentence)}", highlight=False)
    return sentence


def _sentence(error: BaseException, arguments: Sequence[str], command: str) -> str | None:
    """The sentence for an error that the user can resolve, or None for a defect."""
    chain: BaseException | None = error
    while chain is not None:
        if isinstance(chain, InputError):
            return str(chain)
        chain = chain.__cause__
    if isinstance(error, (HydraException, OmegaConfBaseException)):
        return explain(error, arguments, command)
    if isinstance(error, OSError) and error.filename is not None:
        instead = "another folder with `hydra.run.dir=FOLDER`" if command == "train" else "another path"
        return f"`{error.filename}` must be readable and writable, got: {error.strerror}. Try {instead}."
    if full := _disk_error(error):
        return (
            f"`nsm {command}` must be able to write its files, got: {full.strerror}. Try to free space on the disk, or "
            "another folder."
        )
    return None


def _disk_error(error: BaseException | None) -> OSError | None:
    """The error of a full or broken disk from which an error comes, if any."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in DISK_ERRORS:
            return error
        error = error.__cause__ or error.__context__
    return None


@contextmanager
def _cleaning_up_when_terminated() -> Iterator[None]:
    """Let SIGTERM end the process as an exception, so that temporary files are removed."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def leave(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _silence_lightning() -> None:
    """Hide messages that Lightning prints on every run and that need no action."""
    logging.getLogger("lightning.pytorch.utilities.rank_zero").setLevel(logging.WARNING)
    logging.getLogger("lightning.pytorch.accelerators.cuda").setLevel(logging.WARNING)
    for message in (
        ".*does not have many workers.*",
        ".*`IterableDataset` has `__len__`.*",
        ".*exists and is not empty.*",
        ".*treespec, LeafSpec.*",
        ".*sync_dist=True.*",  # all processes that train together validate the same morph
    ):
        warnings.filterwarnings("ignore", message)
