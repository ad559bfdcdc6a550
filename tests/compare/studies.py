"""Studies so small that a test can run them."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf
from runs import BARE, train_here

from nsm.cli import entry
from nsm.cli.configuration import CONF
from nsm.compare import __main__ as compare

#: A study so small that a run takes a second.
SMALL = (
    "+study=figure2",
    "methods=[adadiv,free]",
    "seeds=[0]",
    "learning_rates=null",
    "minutes=null",
    "steps=3",
    "threads=1",
    "volume_resolution=16",
    "surface_resolution=16",
    "times=3",
    "samples=500",
    "strip_times=[0,1]",
    "picture_size=24",
)

#: What makes each of its runs tiny.
TINY = [o for o in BARE if not o.startswith(("+experiment", "steps", "threads", "callbacks"))]


def configuration(*overrides: str) -> dict[str, Any]:
    """The configuration of ``python -m nsm.compare``, without what only the command itself knows."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose("compare", [*overrides])
    return OmegaConf.to_container(cfg, resolve=True)  # type: ignore[return-value]


def compare_here(*overrides: str) -> int:
    before = sys.argv
    sys.argv = ["nsm.compare", *overrides]
    try:
        entry.run(compare.main, "compare")
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        sys.argv = before
    return 0


def tiny(folder: Path, *overrides: str) -> tuple[str, ...]:
    return (*SMALL, f"output={folder}", f"overrides={json.dumps(TINY)}", *overrides)


def forked(arguments: Sequence[str], log: Path, threads: int | None) -> int:
    """Train in a copy of this process, which needs no time to import anything."""
    log.parent.mkdir(parents=True, exist_ok=True)
    child = os.fork()
    if child == 0:
        status = 1
        try:
            GlobalHydra.instance().clear()
            with log.open("w") as output:
                os.dup2(output.fileno(), 1)
                os.dup2(output.fileno(), 2)
            sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115
            status = train_here(*arguments)
        except BaseException as error:
            print(f"{type(error).__name__}: {error}")  # noqa: T201
        finally:
            try:
                sys.stdout.flush()
                sys.stderr.flush()
            except OSError:  # the disk of the log is full
                status = 120  # as Python itself ends
            finally:
                os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def rows(folder: Path) -> dict[str, dict[str, Any]]:
    return {row["method"]: row for row in json.loads((folder / "study.json").read_text())["rows"]}


class Lost:
    """A launcher whose worker dies."""

    def launch(self, *rest: Any, **more: Any) -> None:
        raise RuntimeError("a worker was lost")
