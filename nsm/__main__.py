"""Console script ``nsm``, also ``python -m nsm``: dispatches to the commands."""

from __future__ import annotations

import importlib
import os
import sys

from omegaconf import DictConfig
from rich.console import Console

from nsm.cli import entry
from nsm.cli.help import command_help
from nsm.cli.settings import nearest

#: Commands with what they do, in the order of the help.
COMMANDS = {
    "morph": "morph one shape file into another and write a film, an animation, or meshes",
    "train": "train a morph with every choice and setting at hand",
    "evaluate": "measure trained morphs and tabulate the figures",
    "export": "write a morph as meshes, an animation, or networks for other programs",
    "render": "draw a morph as a strip, a film, a turntable, or slices",
    "view": "show morphs in the browser",
    "layers": "divide the shell between two nested surfaces into layers of equal volume",
    "compare": "run and tabulate a study of methods on pairs of shapes",
}

_HELP = """usage: nsm COMMAND [SETTING=VALUE ...]

Volume-preserving morphs between neural shapes.

{commands}

`nsm COMMAND --help` lists the choices and settings of a command.
`eval "$(nsm -sc install=bash)"` completes commands and settings with Tab."""


def main() -> None:
    """Run the command named by the first argument with the remaining ones."""
    name, *arguments = sys.argv[1:] or ["--help"]
    if name in ("-h", "--help"):
        commands = "\n".join(f"  {command:<10}{does}" for command, does in COMMANDS.items())
        _print(_HELP.format(commands=commands))
    elif name in ("-sc", "--shell-completion"):
        _complete(arguments)
    elif name in COMMANDS:
        sys.argv[1:] = arguments
        _run(name)
    else:
        near = nearest(name, COMMANDS)
        suggestion = f"nsm {near}" if near else "nsm --help"
        message = f"The command must be one of {', '.join(COMMANDS)}, got {name}. Try `{suggestion}`."
        Console(stderr=True, soft_wrap=True, highlight=False).print(f"[bold red]nsm:[/] {message}")
        sys.exit(entry.REFUSED)


def _run(command: str) -> None:
    if command == "morph":
        entry.run_plain(importlib.import_module("nsm.library.command").main, command)
    elif {"-h", "--help"} & set(sys.argv[1:]):
        _print(command_help(command))  # without the seconds that importing a command takes
    else:
        entry.run(importlib.import_module(f"nsm.{command}.__main__").main, command)


def _complete(arguments: list[str]) -> None:
    """Answer the shell: Hydra completes the settings of a command, and the commands are completed here."""
    before, _, rest = os.environ.get("COMP_LINE", "").strip().partition(" ")
    command, separator, typed = rest.lstrip().partition(" ")
    if arguments and arguments[0].startswith("query=") and (not separator or command not in COMMANDS):
        _print(" ".join(COMMANDS))
        return
    os.environ["COMP_LINE"] = f"{before} {typed}"
    sys.argv[:] = ["nsm", "-sc", *arguments]
    entry.run(_nothing, command if command in COMMANDS and command != "morph" else "train")


def _nothing(cfg: DictConfig) -> None:
    """Stand in for the command, which Hydra does not call when it completes settings."""


def _print(text: str) -> None:
    Console(highlight=False, markup=False, soft_wrap=True).print(text)


if __name__ == "__main__":
    main()
