"""Record of the frames in a folder and of the settings they were made with, from which an export resumes."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import nsm
from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write

log = logging.getLogger(__name__)

#: The file in the folder of the frames.
MANIFEST = "frames.json"
#: Level above which f has drifted too far from its volume, relative to the box.
_LARGE_LEVEL = 0.005
#: Characters of a setting that are quoted in a message.
_QUOTED = 60


class Record(NamedTuple):
    """Record of one frame.

    Attributes:
        time: Time in [0, 1].
        level: Value of f on the surface.
        volume: Volume inside the mesh, or area in 2D, in its coordinates.
        components: Number of connected components of the mesh.
        file: Name of the file; None at a time without a surface.
    """

    time: float
    level: float
    volume: float
    components: int
    file: str | None


class Manifest:
    """Frames of a folder by number, kept in a JSON file that is rewritten with each new one.

    Args:
        folder: The folder of the frames.
        settings: Plain values that determine the frames.
        pattern: Glob pattern of the names of the frames.

    Attributes:
        records: The frames that exist already, by number.

    Raises:
        InputError: If the folder holds frames made with other or unknown settings.
    """

    def __init__(self, folder: Path, settings: Mapping[str, Any], pattern: str) -> None:
        self.folder, self.settings = folder, json.loads(json.dumps(settings))
        self.records: dict[int, Record] = {}
        if not (folder / MANIFEST).is_file():
            if strangers := sorted(folder.glob(pattern)):
                raise InputError(
                    f"`output` must be a folder without frames of another export, got {folder}, which holds "
                    f"{strangers[0].name} but no {MANIFEST}. Try another `output`, or remove the frames."
                )
            return
        before = self._read()
        self._require_same(before["settings"])
        for number, entry in before["frames"].items():
            record = Record(**entry)
            if record.file is None or (folder / record.file).is_file():
                self.records[int(number)] = record

    def add(self, number: int, record: Record) -> None:
        """Record a frame that has been written."""
        self.records[number] = record
        self.save()

    def save(self) -> None:
        """Write the file."""
        write_records(self.folder / MANIFEST, self.settings, self.records)

    def remove(self) -> None:
        """Remove the file, and the folder if nothing is left in it."""
        (self.folder / MANIFEST).unlink(missing_ok=True)
        if not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _read(self) -> dict[str, Any]:
        file = self.folder / MANIFEST
        try:
            content = json.loads(file.read_text())
            return {"settings": dict(content["settings"]), "frames": dict(content["frames"])}
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{file} must be the record of an export, got something else. Try another `output`, or remove "
                f"{self.folder}."
            ) from error

    def _require_same(self, before: dict[str, Any]) -> None:
        names = [name for name in self.settings if before.get(name) != self.settings[name]]
        if names:
            differences = ", ".join(f"{n}={_short(before.get(n))} instead of {_short(self.settings[n])}" for n in names)
            raise InputError(
                f"`output` must be a folder without frames of another export, got {self.folder}, whose frames have "
                f"{differences}. Try another `output`, or remove them."
            )


def write_records(path: Path, settings: Mapping[str, Any], records: Mapping[int, Record]) -> None:
    """Write settings and frames as JSON."""
    frames = {str(number): records[number]._asdict() for number in sorted(records)}
    content = {"nsm": nsm.__version__, "settings": dict(settings), "frames": frames}
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n")


def report(records: Mapping[int, Record], exact_volume: bool, width: float) -> None:
    """Log the range of volumes of the frames and the largest level; warn if that is large.

    Args:
        records: The frames by number.
        exact_volume: Whether levels were chosen to enclose the wanted volume; otherwise they are all 0.
        width: Longest edge of the box.
    """
    volumes = [record.volume for record in records.values() if record.file is not None]
    if volumes:
        log.info("volumes of the meshes: %.6g to %.6g", min(volumes), max(volumes))
    if not exact_volume or not volumes:
        return
    furthest = max(records.values(), key=lambda record: abs(record.level))
    log.info("largest level: %.2g, at t = %g", furthest.level, furthest.time)
    if abs(furthest.level) > _LARGE_LEVEL * width:
        log.warning(
            "the level %.2g at t = %g is large: the morph does not preserve its volume there, so the frame is far "
            "from its zero level set",
            furthest.level,
            furthest.time,
        )


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= _QUOTED else text[:_QUOTED] + "…"
