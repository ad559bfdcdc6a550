"""Which frames lie in a folder, and what they are frames of: how an interrupted export goes on."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import nsm
from nsm.cli.errors import InputError
from nsm.cli.files import whole_file

log = logging.getLogger(__name__)

#: The file in the folder of the frames.
MANIFEST = "frames.json"
#: A level as far from 0 as this, as a share of the box, says that f is not what it should be.
_LARGE_LEVEL = 0.005
#: Characters of a setting in a sentence.
_SHOWN = 60


class Record(NamedTuple):
    """One frame.

    Attributes:
        time: from 0 to 1.
        level: the value of f on the surface.
        volume: inside the mesh (area in 2D), in its coordinates.
        components: how many parts the mesh has.
        file: its name; None at a time without a surface.
    """

    time: float
    level: float
    volume: float
    components: int
    file: str | None


class Manifest:
    """The frames of a folder by their numbers, kept in a file of JSON that is rewritten with each new one.

    Args:
        folder: of the frames.
        settings: plain values that decide what the frames are.
        pattern: of the names of the frames.

    Attributes:
        records: the frames that are there already, by number.

    Raises:
        InputError: if the folder holds frames of other settings, or of unknown ones.
    """

    def __init__(self, folder: Path, settings: Mapping[str, Any], pattern: str) -> None:
        self.folder, self.settings = folder, json.loads(json.dumps(settings))
        self.records: dict[int, Record] = {}
        if not (folder / MANIFEST).is_file():
            if strangers := sorted(folder.glob(pattern)):
                raise InputError(
                    f"{folder} holds {strangers[0].name} and no {MANIFEST} that says what it is a frame of: remove the "
                    "frames, or give another output"
                )
            return
        before = self._read()
        self._require_same(before["settings"])
        for number, entry in before["frames"].items():
            record = Record(**entry)
            if record.file is None or (folder / record.file).is_file():
                self.records[int(number)] = record

    def add(self, number: int, record: Record) -> None:
        """Enter a frame that lies in the folder."""
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
                f"{file} does not say what the frames beside it are: remove {self.folder}, or give another output"
            ) from error

    def _require_same(self, before: dict[str, Any]) -> None:
        names = [name for name in self.settings if before.get(name) != self.settings[name]]
        if names:
            differences = ", ".join(
                f"{n}={_short(before.get(n))} in place of {_short(self.settings[n])}" for n in names
            )
            raise InputError(
                f"{self.folder} holds frames of another export, with {differences}: give another output, or remove them"
            )


def write_records(path: Path, settings: Mapping[str, Any], records: Mapping[int, Record]) -> None:
    """Write settings and frames as JSON."""
    frames = {str(number): records[number]._asdict() for number in sorted(records)}
    content = {"nsm": nsm.__version__, "settings": dict(settings), "frames": frames}
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n")


def report(records: Mapping[int, Record], exact_volume: bool, width: float) -> None:
    """Log the volumes of the frames and, where levels were chosen, the largest; warn if it is not small.

    Args:
        records: the frames.
        exact_volume: whether levels were chosen.
        width: of the box.
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
            "the level %.2g at t = %g is not small: the morph itself does not keep its volume there, and what is shown "
            "is another surface of it",
            furthest.level,
            furthest.time,
        )


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "…"
