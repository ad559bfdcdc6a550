"""Processes that train together, one per device of this machine: started together, and ended together."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import lightning as L
import torch
from lightning.fabric.plugins.environments import LightningEnvironment
from lightning.pytorch.strategies.launchers.subprocess_script import _SubprocessScriptLauncher
from rich.console import Console
from rich.markup import escape

from nsm.cli.child import MODULE
from nsm.cli.entry import REFUSED
from nsm.cli.errors import InputError
from nsm.cli.overrides import literal

#: Seconds that this process may take to end by itself after another one has died, before it is ended.
_PATIENCE = 30.0
#: Seconds within which a death shows that makes communication fail, and in which processes end after training.
_NOTICE, _FAREWELL = 5.0, 60.0
#: Seconds between two looks at the processes.
_INTERVAL = 0.5


def processes_to_start(trainer: L.Trainer) -> int:
    """Number of processes on this machine, of which all but this one must be started; 1 where none must be.

    A cluster, ``torchrun``, or the process that started this one may have started them already.

    Args:
        trainer: Trainer with the devices and the strategy of the run.
    """
    launcher = trainer.strategy.launcher
    if not isinstance(launcher, _SubprocessScriptLauncher) or launcher.cluster_environment.creates_processes_externally:
        return 1
    return launcher.num_processes


@contextmanager
def training_together(number: int, nodes: int, overrides: Sequence[str], folder: Path) -> Iterator[None]:
    """Start the other processes of a run, and end all of them when one ends early.

    The others run the same command with the environment that Lightning expects. They print into ``process_1.log`` and
    so on in the folder of the run, and do not outlive this process.

    Args:
        number: Number of processes on this machine, with this one.
        nodes: Number of machines.
        overrides: Overrides of the run.
        folder: Folder of the run.

    Raises:
        InputError: If another process ended early.
    """
    if number == 1:
        yield
        return
    before = dict(os.environ)
    os.environ.update(_environment(number, nodes))
    others = [_start(rank, overrides, folder) for rank in range(1, number)]
    done = threading.Event()
    watch = threading.Thread(target=_watch, args=(others, done, folder), daemon=True)
    watch.start()
    try:
        yield
        _wait(others, _FAREWELL)
    except InputError:
        raise
    except Exception as error:
        dead = _dead(others, _NOTICE)
        if dead is None:
            raise
        raise _ended_early(dead, others, folder) from error
    finally:
        done.set()
        for other in others:
            other.kill()
            other.communicate()
        if torch.distributed.is_initialized():
            torch.distributed.destroy_process_group()
        os.environ.clear()
        os.environ.update(before)


def _environment(number: int, nodes: int) -> dict[str, str]:
    """Variables from which Lightning knows the processes; those that the user has set stay."""
    standard = LightningEnvironment()
    wanted = {
        "MASTER_ADDR": standard.main_address,
        "MASTER_PORT": str(_free_port()),
        "NODE_RANK": str(standard.node_rank()),
    }
    given = {name: os.environ.get(name, value) for name, value in wanted.items()}
    return {**given, "LOCAL_RANK": "0", "WORLD_SIZE": str(number * nodes)}


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _start(rank: int, overrides: Sequence[str], folder: Path) -> subprocess.Popen[bytes]:
    command = [
        *(sys.executable, "-m", MODULE, "nsm.train", *overrides),
        f"hydra.run.dir={literal(str(folder.resolve()))}",
        "hydra.output_subdir=null",
        f"hydra.job.name=process_{rank}",
        # its messages are those of this process, which prints and logs them
        "hydra/job_logging=none",
    ]
    folder.mkdir(parents=True, exist_ok=True)
    with _log(rank, folder).open("w") as output:
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, "LOCAL_RANK": str(rank)},
        )


def _log(rank: int, folder: Path) -> Path:
    return folder / f"process_{rank}.log"


def _watch(others: Sequence[subprocess.Popen[bytes]], done: threading.Event, folder: Path) -> None:
    """End this process where another one has died and communication, which then fails, waits forever instead."""
    while not done.wait(_INTERVAL):
        if (dead := _dead(others)) is None:
            continue
        if not done.wait(_PATIENCE):
            sentence = escape(str(_ended_early(dead, others, folder)))
            Console(stderr=True, soft_wrap=True).print(f"[bold red]nsm:[/] {sentence}", highlight=False)
            for other in others:
                other.kill()
            os._exit(REFUSED)


def _dead(others: Sequence[subprocess.Popen[bytes]], seconds: float = 0.0) -> int | None:
    """Rank of the first process that ended with an error within some seconds; None if there is none."""
    deadline = time.monotonic() + seconds
    while True:
        for rank, other in enumerate(others, 1):
            if other.poll():
                return rank
        if time.monotonic() >= deadline:
            return None
        time.sleep(_INTERVAL / 10)


def _wait(others: Sequence[subprocess.Popen[bytes]], seconds: float) -> None:
    deadline = time.monotonic() + seconds
    for other in others:
        try:
            other.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            return


def _ended_early(rank: int, others: Sequence[subprocess.Popen[bytes]], folder: Path) -> InputError:
    """The error for a process that did not run to the end."""
    status = others[rank - 1].returncode
    end = f"status {status}" if status > 0 else f"signal {-status}"
    return InputError(
        f"The {len(others) + 1} processes that train together must all run to the end, got the end of process {rank} "
        f"with {end}; {_log(rank, folder)} may say why. Try the command with `hydra.run.dir={folder} resume=true`."
    )
