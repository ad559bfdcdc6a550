"""Commands that are attacked: each runs in a copy of this process, which needs no time to import anything."""

from __future__ import annotations

import csv
import io
import json
import os
import signal
import sys
import time
import zipfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch
from analytic import save, turning
from hydra.core.global_hydra import GlobalHydra
from PIL import Image
from runs import DISK, TINY

from nsm.__main__ import main as nsm

sys.path.append(str(Path(__file__).resolve().parents[1] / "compare"))

#: Operations by which a file appears, changes, or goes, as Python's audit hooks name them.
_CHANGES = ("os.rename", "os.remove", "os.rmdir", "os.mkdir")


@dataclass(frozen=True, eq=False)
class Victim:
    """A command that is attacked.

    Attributes:
        name: Command.
        arguments: Arguments, in which ``{folder}`` is the folder that it may write to.
        dim: Dimension of the morph in ``morph.ckpt`` there, which it reads.
        patches: Objects of the package that are replaced, by name, so that it takes less time.
        nightly: Whether it is attacked by the nightly run only, because it takes long.
    """

    name: str
    arguments: Sequence[str]
    dim: int = 0
    patches: dict[str, Callable[..., Any]] = field(default_factory=dict)
    nightly: bool = False

    def __str__(self) -> str:
        formats = [argument for argument in self.arguments if argument.startswith(("format=", "kind=", "record="))]
        return " ".join(["nsm", self.name, *(argument.partition("{")[0].rstrip("=") for argument in formats)])


def _exported(name: str, dim: int, *more: str, nightly: bool = False) -> Victim:
    frames = ("times=3", "resolution=12") if name in ("obj", "ply", "glb", "usd") else ()
    arguments = ("checkpoint={folder}/morph.ckpt", "output={folder}/export", f"format={name}", *frames, *more)
    return Victim("export", (*arguments, "threads=1"), dim, nightly=nightly)


def _tiny_morph(*arguments: Any, **options: Any) -> Any:
    """`nsm.morph` with so few steps and points that it takes a second."""
    from nsm.library import training

    wanted = training._settings  # the settings of a run, to which those of the tests are added
    small = [setting for setting in TINY if not setting.startswith(("init", "callbacks", "threads"))]
    with mock.patch.object(training, "_settings", lambda *given: [*wanted(*given), *small]):
        gentle = {"steps": 2, "init": "source", "optimizer": {"lr": 1e-4}}  # so that nothing collapses
        return training.morph(*arguments, **{**options, **gentle})


def _forked_training(arguments: Sequence[str], log: Path, threads: int | None) -> int:
    from studies import forked

    return forked(arguments, log, threads)


_STUDY = (
    "+study=figure2",
    "methods=[adadiv]",
    "minutes=null",
    "steps=3",
    "threads=1",
    "volume_resolution=16",
    "surface_resolution=16",
    "times=3",
    "samples=500",
    "strip_times=[0,1]",
    "picture_size=24",
    "output={folder}/study",
    "overrides=" + json.dumps([o for o in TINY if not o.startswith(("threads", "callbacks"))]),
)
_SMALL = (
    "volume_resolution=16",
    "surface_resolution=16",
    "times=3",
    "samples=500",
    "picture_size=24",
    "slices.times=[0,1]",
)

_GIVEN = "checkpoint={folder}/morph.ckpt"
_STRIP = ("output={folder}/strip.png", "kind=strip", "size=24", "times=[0,1]", "resolution=12")
_FILM = ("output={folder}/film.mp4", "kind=film", "size=[64,64]", "seconds=0.2", "fps=10", "resolution=12")
_PAGE = ("record={folder}/page.html", "times=2", "resolution=8", "threads=1")
_FILES = ("{folder}/a.svg", "{folder}/b.svg", "-o", "{folder}/morph.png", "--frames", "2", "--resolution", "8")

VICTIMS = [
    Victim("train", (*DISK, "hydra.run.dir={folder}/run", "resume=true")),
    _exported("obj", 2),
    Victim("render", (_GIVEN, *_STRIP), 2, nightly=True),
    Victim("evaluate", (_GIVEN, "output={folder}/evaluation", *_SMALL, "threads=1"), 2, nightly=True),
    _exported("glb", 3, nightly=True),
    _exported("usd", 3, nightly=True),
    _exported("safetensors", 2, nightly=True),
    _exported("pt2", 2, nightly=True),
    _exported("onnx", 2, nightly=True),
    Victim("render", (_GIVEN, *_FILM), 2, nightly=True),
    Victim("view", (_GIVEN, *_PAGE), 3, nightly=True),
    Victim("compare", _STUDY, patches={"nsm.compare.run._start": _forked_training}, nightly=True),
    Victim("morph", _FILES, patches={"nsm.library.command.morph": _tiny_morph}, nightly=True),
]


def prepare(victim: Victim, folder: Path) -> None:
    """Write what a command reads into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    if victim.dim:
        save(turning(victim.dim, 0.1), folder / "morph.ckpt")
    if victim.name == "morph":
        for name, radius in (("a", 40), ("b", 30)):
            circle = f'<circle cx="50" cy="50" r="{radius}"/>'
            page = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100">{circle}</svg>'
            (folder / f"{name}.svg").write_text(page)


@dataclass(frozen=True)
class Outcome:
    """How a command ended.

    Attributes:
        status: Exit status, negative for a signal.
        said: What it wrote to the terminal.
        changes: Number of operations that changed its folder.
        seconds: Its duration.
    """

    status: int
    said: str
    changes: int
    seconds: float


def run(victim: Victim, folder: Path, scratch: Path, kill_before: int = 0, kill_after: float = 0.0) -> Outcome:
    """Run a command in a copy of this process, and kill it if wanted.

    Args:
        victim: The command.
        folder: Folder that it may write to.
        scratch: Folder for its output.
        kill_before: Number of the operation on a file before which it is killed; 0 for none.
        kill_after: Seconds after which it is killed; 0 for never.
    """
    scratch.mkdir(parents=True, exist_ok=True)
    said, counted, begin = scratch / "said.txt", scratch / "count.txt", time.monotonic()
    counted.write_text("0")
    child = os.fork()
    if child == 0:
        status = 70
        try:
            with said.open("w") as output:
                os.dup2(output.fileno(), 1)
                os.dup2(output.fileno(), 2)
            sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115
            status = _attacked(victim, folder, counted, kill_before, kill_after)
        finally:
            with suppress(Exception):
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(status)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    seconds = time.monotonic() - begin
    return Outcome(status, said.read_text(errors="replace"), int(counted.read_text()), seconds)


def _attacked(victim: Victim, folder: Path, counted: Path, kill_before: int, kill_after: float) -> int:
    GlobalHydra.instance().clear()
    changes = 0

    def count(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal changes
        changing = event in _CHANGES or (event == "open" and arguments[2] & (os.O_WRONLY | os.O_RDWR))
        if changing and isinstance(arguments[0], str | Path) and str(arguments[0]).startswith(str(folder)):
            changes += 1
            if changes == kill_before:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.argv = ["nsm", victim.name, *(argument.replace("{folder}", str(folder)) for argument in victim.arguments)]
    with ExitStack() as patched:
        for name, replacement in victim.patches.items():
            patched.enter_context(mock.patch(name, replacement))
        sys.addaudithook(count)
        if kill_after:
            signal.signal(signal.SIGALRM, signal.SIG_DFL)  # which ends the process as SIGKILL does
            signal.setitimer(signal.ITIMER_REAL, kill_after)
        try:
            nsm()
        except SystemExit as end:
            return int(end.code or 0)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            counted.write_text(str(changes))
    return 0


def files(folder: Path) -> set[str]:
    """Names of the files below a folder that a command is asked for, and not the records of Hydra and of its log."""
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    return {name for name in names if "/.hydra/" not in name and not name.endswith(".log")}


def require_whole(folder: Path) -> None:
    """Read all files that a command has written, except those in its scratch folders."""
    for name in files(folder):
        if "/.nsm-" not in f"/{name}":
            _read(folder / name)


def _read(file: Path) -> None:
    data = file.read_bytes()
    assert data or file.suffix == ".lock", f"{file} is empty"
    match file.suffix:
        case ".ckpt":
            torch.load(file, weights_only=True)
        case ".json":
            json.loads(data)
        case ".csv":
            rows = list(csv.reader(io.StringIO(data.decode())))
            assert data.endswith(b"\n"), file
            assert len({len(row) for row in rows}) == 1, file
        case ".png":
            Image.open(io.BytesIO(data)).load()
        case ".npz":
            with np.load(file) as arrays:
                assert all(len(arrays[name]) >= 0 for name in arrays)
        case ".obj" | ".md" | ".tex":
            assert data.endswith(b"\n"), file
        case ".glb":
            assert int.from_bytes(data[8:12], "little") == len(data), file
        case ".mp4":
            assert b"moov" in data, file
        case ".html":
            assert data.rstrip().endswith(b"</html>"), file
        case ".pt2" | ".usdz":
            assert zipfile.is_zipfile(file), file
