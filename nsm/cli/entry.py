"""What every command does around its work: plain sentences for people, exit codes for scripts."""

from __future__ import annotations

import logging
import os
import signal
import sys
import warnings
from collections.abc import Callable
from functools import wraps

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError

#: Exit status when what was asked for cannot be done.
REFUSED = 2
#: Settings that take one name or several; between several a comma is enough, without the brackets of a list.
_NAMES = ("checkpoint", "official")


def run(main: Callable[[DictConfig], None], config_name: str) -> None:
    """Run a command with its composed configuration.

    An `InputError`, an error of the configuration, or a folder that cannot be written ends it with one sentence and
    status 2; anything else is a defect and keeps its traceback. In a multirun the other runs go on.

    Args:
        main: the command; it gets the configuration, which it may not change.
        config_name: the file in ``conf/``.
    """
    os.environ["HYDRA_FULL_ERROR"] = "1"  # or Hydra prints the traceback itself and exits
    _quieten()
    refused: list[str] = []

    @wraps(main)
    def tell(cfg: DictConfig) -> None:
        try:
            main(cfg)
        except Exception as error:
            refused.append(_tell(error))

    if not {"-m", "--multirun"} & set(sys.argv):
        sys.argv[1:] = [_as_list(argument) for argument in sys.argv[1:]]
    try:
        hydra.main(config_path=str(CONF), config_name=config_name, version_base="1.3")(tell)()
    except Exception as error:
        refused.append(_tell(error))
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    if refused:
        sys.exit(REFUSED)


def _as_list(argument: str) -> str:
    """``checkpoint=a,b`` as Hydra takes it, ``checkpoint=[a,b]``; any other argument as it is."""
    name, _, value = argument.partition("=")
    several = name in _NAMES and "," in value and value[0] not in "[\"'"
    return f"{name}=[{value}]" if several else argument


def _tell(error: Exception) -> str:
    """Print the sentence of an error and return it, or raise the error again if it has none."""
    sentence = _sentence(error)
    if sentence is None:
        raise error
    Console(stderr=True, soft_wrap=True).print(f"[bold red]nsm:[/] {_escaped(sentence)}", highlight=False)
    return sentence


def _sentence(error: BaseException) -> str | None:
    """What to tell about an error that is the user's to mend, or None for a defect."""
    chain: BaseException | None = error
    while chain is not None:
        if isinstance(chain, InputError):
            return str(chain)
        chain = chain.__cause__
    if isinstance(error, (HydraException, OmegaConfBaseException)):
        return " ".join(str(error).split())
    if isinstance(error, OSError) and error.filename is not None:
        return (
            f"{error.filename} cannot be written or read ({error.strerror}): choose another hydra.run.dir, or free it"
        )
    return None


def _escaped(text: str) -> str:
    return text.replace("[", r"\[")


def _quieten() -> None:
    """Leave out what Lightning tells on every run and nobody can act on."""
    logging.getLogger("lightning.pytorch.utilities.rank_zero").setLevel(logging.WARNING)
    logging.getLogger("lightning.pytorch.accelerators.cuda").setLevel(logging.WARNING)
    for message in (
        ".*does not have many workers.*",
        ".*`IterableDataset` has `__len__`.*",
        ".*exists and is not empty.*",
        ".*treespec, LeafSpec.*",
    ):
        warnings.filterwarnings("ignore", message)
