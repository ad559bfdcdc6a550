"""Overrides that choose a shape from a file, told by its suffix."""

from __future__ import annotations

from pathlib import Path

#: Option of ``conf/shape`` for each suffix; a PLY file without faces holds points.
OPTIONS = {
    **dict.fromkeys((".obj", ".ply", ".stl", ".off", ".glb"), "mesh"),
    ".xyz": "points",
    **dict.fromkeys((".pth", ".pt"), "siren"),
    ".ckpt": "fitted",
}
#: Bytes of a PLY file that hold its header.
_HEADER = 4096


def shape_option(path: Path) -> str | None:
    """Name the option of ``conf/shape`` that reads a file or the folder of a run; None for an unknown suffix."""
    if path.is_dir():
        return "fitted"
    suffix = path.suffix.lower()
    if suffix == ".ply" and path.is_file() and not _has_faces(path):
        return "points"
    return OPTIONS.get(suffix)


def shape_overrides(side: str, path: str) -> list[str]:
    """Overrides that choose the file ``path`` as ``source`` or ``target``; a mesh where the suffix says nothing.

    >>> shape_overrides("source", "a.obj")
    ['shape@source=mesh', 'source.path=a.obj']
    """
    return [f"shape@{side}={shape_option(Path(path)) or 'mesh'}", f"{side}.path={quoted(path)}"]


def quoted(value: str) -> str:
    """Write a text as a value of an override, in quotes where Hydra's grammar needs them.

    >>> quoted("a.obj"), quoted("a=b.obj")
    ('a.obj', "'a=b.obj'")
    """
    if value and all(character.isalnum() or character in "/-+.$%*@?|_" for character in value):
        return value
    escaped = value.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def _has_faces(path: Path) -> bool:
    with path.open("rb") as file:
        header = file.read(_HEADER).split(b"end_header")[0]
    faces = [line.split()[-1] for line in header.splitlines() if line.startswith(b"element face")]
    return bool(faces) and faces[0] != b"0"
