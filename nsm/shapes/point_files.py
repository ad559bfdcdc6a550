"""Reading of point clouds, with normals if the file contains them."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh

from nsm.cli.errors import InputError
from nsm.cli.extras import require
from nsm.shapes.reading import require_content, unreadable

log = logging.getLogger(__name__)

#: Extensions of supported files.
POINT_FORMATS = (".ply", ".xyz", ".txt", ".npy", ".las", ".laz")
#: Number of points above which a random subset is used.
MAX_POINTS = 1_000_000


class PointColumns(NamedTuple):
    """Points of a file.

    Attributes:
        points: Points in the coordinates of the file, shape (n, 3).
        normals: Normals, shape (n, 3), or None if the file contains none.
    """

    points: np.ndarray
    normals: np.ndarray | None


def read_points(file: Path) -> PointColumns:
    """Read the points of a file.

    Raises:
        InputError: If the extension is not supported, or the content is damaged or not a cloud in 3D.
    """
    suffix = file.suffix.lower()
    if suffix not in POINT_FORMATS:
        raise InputError(
            f"The name of a point cloud must end in {', '.join(POINT_FORMATS)}, got '{file.suffix}' ({file}). Try "
            "`points.ply`."
        )
    require_content(file, "points")
    try:
        rows = _READERS[suffix](file)
    except InputError:
        raise
    except Exception as error:  # readers raise various exceptions for damaged files
        raise unreadable(file, "points", error) from error
    return as_columns(rows, str(file))


def as_columns(rows: np.ndarray, name: str) -> PointColumns:
    """Split rows of three or six numbers into points and normals; colors in place of normals are ignored.

    Raises:
        InputError: If rows do not have three or six numbers.
    """
    if rows.ndim != 2 or rows.shape[1] not in (3, 6):
        raise InputError(
            f"`{name}` must hold rows of three numbers (x y z) or six (x y z nx ny nz), got an array of shape "
            f"{tuple(rows.shape)}. Try one row per point."
        )
    rows = np.asarray(rows, dtype=np.float64)
    if len(rows) > MAX_POINTS:
        log.warning("%s has %d points, of which %d are drawn at random", name, len(rows), MAX_POINTS)
        rows = rows[np.sort(np.random.default_rng(0).choice(len(rows), MAX_POINTS, replace=False))]
    points, rest = rows[:, :3], rows[:, 3:]
    if rest.shape[1] and _are_colors(rest):
        log.warning("columns 4 to 6 of %s are whole numbers up to 255: they are taken for colors, not normals", name)
        return PointColumns(points, None)
    return PointColumns(points, rest if rest.shape[1] else None)


def _are_colors(columns: np.ndarray) -> bool:
    """Check whether three columns are 8-bit colors."""
    whole = bool((columns == np.round(columns)).all())
    return whole and float(columns.min()) >= 0 and 1 < float(columns.max()) <= 255


def _text_rows(file: Path) -> np.ndarray:
    """Read numbers separated by spaces or commas."""
    with file.open(encoding="utf-8") as lines:
        return np.loadtxt((line.replace(",", " ") for line in lines), ndmin=2, dtype=np.float64)


def _npy_rows(file: Path) -> np.ndarray:
    return np.asarray(np.load(file, allow_pickle=False))


def _ply_rows(file: Path) -> np.ndarray:
    """Read the columns x, y, z, nx, ny, nz of the vertices, or only x, y, z."""
    cloud = trimesh.load(file, process=False)
    data = cloud.metadata["_ply_raw"]["vertex"]["data"]
    names = data.dtype.names if isinstance(data, np.ndarray) else list(data)
    positions, normals = ("x", "y", "z"), ("nx", "ny", "nz")
    columns = positions + normals if set(normals) <= set(names) else positions
    return np.stack([np.asarray(data[c], dtype=np.float64).reshape(-1) for c in columns], 1)


def _las_rows(file: Path) -> np.ndarray:
    needed = ("laspy", "lazrs") if file.suffix.lower() == ".laz" else ("laspy",)
    require(*needed, extra="lidar", task=f"Reading {file.suffix.lower()}")
    import laspy

    with laspy.open(file) as reader:
        content = reader.read()
    return np.stack([np.asarray(content.x), np.asarray(content.y), np.asarray(content.z)], 1)


_READERS = {
    ".ply": _ply_rows,
    ".xyz": _text_rows,
    ".txt": _text_rows,
    ".npy": _npy_rows,
    ".las": _las_rows,
    ".laz": _las_rows,
}
