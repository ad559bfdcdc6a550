"""Requests for an export, and the interface of its formats."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nsm.cli.errors import InputError
from nsm.cli.settings import choice
from nsm.types import Morph

#: Coordinate systems that vertices may have.
COORDINATES = ("morph", "source", "target")


@dataclass(frozen=True)
class Request:
    """What to write of a morph, independent of the format.

    Attributes:
        morph: The morph.
        output: A folder, or for formats of a single file also its name.
        times: Times in [0, 1], one per frame.
        resolution: Cells along the longest edge of the box.
        coordinates: Coordinates of the vertices: ``morph`` for those of the box; ``source`` or ``target`` for those of
            that end's file or formula, in which its fit, pose, and scale are undone.
        exact_volume: Whether each frame is the level set that encloses exactly the wanted volume.
        advect: Whether one mesh is advected along V, instead of a surface extracted at each time.
        correspondences: Whether an advected mesh comes with the points of the target that its vertices reach.
        mesh: File of the mesh to advect, in the coordinates of the source's file; None for the surface at t = 0.
        project: Whether an advected mesh is kept on the surface of f.
        seconds: Duration of an animation.
        labels: File of a volume of labels, in the coordinates of the file of an end, for the format that carries it.
        identity: Further values that determine the frames, such as the hash of the checkpoint, so that an interrupted
            export resumes only if nothing has changed.

    Raises:
        InputError: If the settings contradict each other.
    """

    morph: Morph
    output: Path
    times: list[float]
    resolution: int = 256
    coordinates: str = "morph"
    exact_volume: bool = False
    advect: bool = False
    correspondences: bool = False
    mesh: str | None = None
    project: bool = True
    seconds: float = 4.0
    labels: str | None = None
    identity: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        choice("coordinates", self.coordinates, COORDINATES)
        if self.advect and self.exact_volume:
            raise InputError(
                "`exact_volume=true` must come without `advect=true`, got both: it selects levels of extracted "
                "surfaces, and an advected one is not extracted. Try `advect=false`."
            )
        if self.mesh is not None and not self.advect:
            raise InputError(
                f"`mesh` must come with `advect=true`, got {self.mesh} without it. Try `advect=true mesh={self.mesh}`."
            )


class Format(ABC):
    """A file format for morphs.

    Attributes:
        dims: Dimensions of the morphs that it can hold.
        advects: Whether morphs with a velocity are advected unless the setting ``advect`` says otherwise.
        holds_networks: Whether it holds the networks of a morph, and not its surfaces.
        carries_labels: Whether it needs a volume of labels, the setting ``labels``.
        suffixes: Suffixes of its file, with the dot, the default first; empty if it is a folder.
        resolution: Cells along the longest edge of the box unless the setting ``resolution`` says otherwise.
        coordinates: Coordinate system unless the setting ``coordinates`` says otherwise.
    """

    dims: tuple[int, ...] = (3,)
    advects: bool = False
    holds_networks: bool = False
    carries_labels: bool = False
    suffixes: tuple[str, ...] = ()
    resolution: int = 256
    coordinates: str = "morph"

    @abstractmethod
    def export(self, request: Request) -> Path:
        """Write a morph, with progress on stderr, and return the file or folder.

        Raises:
            InputError: If the format cannot hold what is requested, or the file cannot be written.
        """


def refuse_surface_settings(request: Request, name: str, content: str) -> None:
    """Refuse settings that only concern surfaces, for a format that holds none.

    Args:
        request: The request.
        name: Name of the format.
        content: What the format holds instead.

    Raises:
        InputError: If such a setting is on.
    """
    for setting, requested in (("exact_volume", request.exact_volume), ("advect", request.advect)):
        if requested:
            raise InputError(
                f"`{setting}=true` must come with a format of surfaces, got `format={name}`, which holds {content}. "
                "Try `format=ply`."
            )


def one_file(output: Path, suffixes: tuple[str, ...]) -> Path:
    """Return the file that ``output`` names: itself if it ends in one of the suffixes, else ``morph`` in that folder.

    >>> one_file(Path("outputs/demo/export"), (".glb",)).as_posix()
    'outputs/demo/export/morph.glb'
    """
    return output if output.suffix.lower() in suffixes else output / f"morph{suffixes[0]}"
