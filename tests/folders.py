"""Files that an export leaves in a folder."""

from __future__ import annotations

from pathlib import Path

import trimesh


def names(folder: Path) -> list[str]:
    """Paths of all files below a folder, relative to it."""
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())


def read_mesh(file: Path) -> trimesh.Trimesh:
    """Read a mesh exactly as the file stores it."""
    mesh = trimesh.load(file, force="mesh", process=False)
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh
