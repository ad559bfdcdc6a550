"""Reading of voxel volumes, with the map from indices to the coordinates of the scanner."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nsm.cli.errors import InputError
from nsm.cli.extras import require
from nsm.shapes.reading import require_content, unreadable

#: Extensions of supported files.
VOLUME_FORMATS = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mgz", ".mgh", ".tif", ".tiff")


class Voxels(NamedTuple):
    """A volume of voxels.

    Attributes:
        values: Values of the voxels, shape (i, j, k).
        affine: Matrix that maps the index of a voxel to the coordinates of its center, shape (4, 4).
    """

    values: np.ndarray
    affine: np.ndarray


def read_voxels(file: Path) -> Voxels:
    """Read a volume from a file.

    NIfTI and MGH files give coordinates in millimeters to the right, the front, and the top of a patient (RAS); NRRD
    files in the space that they name; TIFF files (column, row, page) times the spacing, which is 1 unless ImageJ wrote
    it.

    Raises:
        InputError: If the file cannot be read, or contains no volume.
    """
    suffix = volume_suffix(file)
    require_content(file, "a volume")
    reader = _READERS[suffix](suffix)
    try:
        values, affine = reader(file)
    except InputError:
        raise
    except Exception as error:  # readers raise various exceptions for damaged files
        raise unreadable(file, "a volume", error) from error
    values = values.reshape(values.shape[:3]) if values.ndim > 3 and set(values.shape[3:]) == {1} else values
    if values.ndim != 3:
        raise InputError(
            f"`{file}` must hold a volume with three axes, got an array of shape {tuple(values.shape)}. Try saving one "
            "volume of labels."
        )
    affine = np.asarray(affine, dtype=np.float64)
    if not np.isfinite(affine).all() or abs(np.linalg.det(affine[:3, :3])) < 1e-30:
        raise InputError(
            f"`{file}` must place its voxels by a matrix that can be inverted, got {affine[:3, :3].tolist()}. Try "
            "`spacing=[1,1,1]`."
        )
    return Voxels(values, affine)


def volume_suffix(file: Path) -> str:
    """Find the extension that determines the format of a volume.

    Raises:
        InputError: If the extension is not supported.
    """
    name = file.name.lower()
    for suffix in VOLUME_FORMATS:
        if name.endswith(suffix):
            return suffix
    raise InputError(
        f"The name of a volume of labels must end in {', '.join(VOLUME_FORMATS)}, got {file}. Try `labels.nii.gz`."
    )


def spaced(spacing: Sequence[float]) -> np.ndarray:
    """Build the matrix of a grid with given distances between voxels and the first voxel at the origin.

    Raises:
        InputError: If they are not three positive numbers.
    """
    lengths = [float(length) for length in spacing]
    if len(lengths) != 3 or not all(0 < length < float("inf") for length in lengths):
        raise InputError(f"`spacing` must be three positive numbers, got {lengths}. Try `spacing=[1,1,1]`.")
    return np.diag([*lengths, 1.0])


def _nibabel_reader(suffix: str) -> Any:
    require("nibabel", extra="medical", task=f"Reading {suffix}")
    import nibabel

    def read(file: Path) -> tuple[np.ndarray, np.ndarray]:
        image: Any = nibabel.load(file)
        return np.asanyarray(image.dataobj), image.affine

    return read


def _nrrd_reader(suffix: str) -> Any:
    require("nrrd", extra="medical", task=f"Reading {suffix}")
    import nrrd

    def read(file: Path) -> tuple[np.ndarray, np.ndarray]:
        values, header = nrrd.read(str(file))
        affine = np.eye(4)
        directions = header.get("space directions")
        if directions is not None:
            rows = np.asarray(directions, dtype=np.float64)
            affine[:3, :3] = rows[np.isfinite(rows).all(1)].T
        elif "spacings" in header:
            affine = spaced(header["spacings"])
        if "space origin" in header:
            affine[:3, 3] = header["space origin"]
        return values, affine

    return read


def _tiff_reader(suffix: str) -> Any:
    require("tifffile", extra="medical", task=f"Reading {suffix}")
    import tifffile

    def read(file: Path) -> tuple[np.ndarray, np.ndarray]:
        with tifffile.TiffFile(file) as tiff:
            pages = tiff.series[0].asarray()
            spacing = [1.0, 1.0, 1.0]
            if tiff.imagej_metadata:  # other programs write the print resolution
                spacing = [*_pixel_size(tiff.pages[0]), float(tiff.imagej_metadata.get("spacing", 1.0))]
        return pages.squeeze().T, spaced(spacing)

    return read


def _pixel_size(page: Any) -> list[float]:
    """Compute width and height of a pixel from tags, which contain pixels per unit of length as fractions."""
    fractions = [page.tags[name].value for name in ("XResolution", "YResolution") if name in page.tags]
    sizes = [units / pixels for pixels, units in fractions if pixels and units]
    return sizes if len(sizes) == 2 else [1.0, 1.0]


_READERS = {
    ".nii": _nibabel_reader,
    ".nii.gz": _nibabel_reader,
    ".mgz": _nibabel_reader,
    ".mgh": _nibabel_reader,
    ".nrrd": _nrrd_reader,
    ".nhdr": _nrrd_reader,
    ".tif": _tiff_reader,
    ".tiff": _tiff_reader,
}
