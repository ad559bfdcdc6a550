"""What is asked of an export, and what each format is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress

from nsm.cli.errors import InputError
from nsm.types import Morph

#: Whose coordinates the vertices may have.
FRAMES = ("morph", "source", "target")


@dataclass(frozen=True)
class Request:
    """What shall be written of a morph.

    Attributes:
        morph: the morph.
        output: a folder; for a format of one file also its name.
        times: one a frame.
        resolution: cells along the longest edge of the box.
        frame: the vertices' coordinates: ``morph`` for those of the box; ``source`` or ``target`` for those of that
            end's file (or formula), so that fit, pose and normalization of its volume are undone.
        exact_volume: whether each frame has the level at which its volume is the wanted one.
        transport: whether one mesh is carried along V, in place of a surface extracted at each time.
        mesh: what is carried, a file in the coordinates of the source's; None for the surface at t = 0.
        project: whether what is carried is kept on the surface of f.
        seconds: how long an animation lasts.
        identity: what else decides what is written, so that an interrupted export goes on only where it belongs: the
            content of the checkpoint, the growth.
    """

    morph: Morph
    output: Path
    times: list[float]
    resolution: int = 256
    frame: str = "morph"
    exact_volume: bool = False
    transport: bool = False
    mesh: str | None = None
    project: bool = True
    seconds: float = 4.0
    identity: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        if self.frame not in FRAMES:
            raise InputError(f"frame={self.frame} is not known: give one of {', '.join(FRAMES)}")
        if self.transport and self.exact_volume:
            raise InputError(
                "exact_volume=true chooses the level of surfaces that are extracted, and transport=true carries one: "
                "leave out one of them"
            )
        if self.mesh is not None and not self.transport:
            raise InputError(f"mesh={self.mesh} is carried along the velocity: add transport=true, or leave it out")


class Format(ABC):
    """A format that a morph can be written in.

    Attributes:
        dims: dimensions of the morphs that it can hold.
    """

    dims: tuple[int, ...] = (3,)

    @abstractmethod
    def export(self, request: Request) -> Path:
        """Write what is asked for, with progress on stderr, and return where it is.

        Raises:
            InputError: if it cannot be written.
        """


def one_file(output: Path, suffixes: tuple[str, ...]) -> Path:
    """The file that ``output`` means: itself if it ends in one of the suffixes, else ``morph`` in that folder."""
    return output if output.suffix.lower() in suffixes else output / f"morph{suffixes[0]}"


def progress_bar() -> Progress:
    """On stderr, so that what is written to stdout stays clean."""
    return Progress(console=Console(stderr=True))
