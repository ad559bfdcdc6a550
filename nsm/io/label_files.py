"""Volumes of labels written like another file: in its format, on its grid, and at its place in the scanner."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from nsm.cli.extras import require
from nsm.cli.files import atomic_write
from nsm.shapes.volume_files import volume_suffix

#: Entries of a NRRD header that follow from the values, or name a file of its own for them.
_FROM_VALUES = ("type", "dimension", "sizes", "kinds", "endian", "encoding", "data file", "datafile")


def write_labels_like(path: Path, template: Path, labels: np.ndarray) -> None:
    """Write labels in the format of another volume, with its header: the affine, spacing, origin, and units.

    Args:
        path: The file to write, which ends as `labels_suffix` says.
        template: The volume whose grid the labels have.
        labels: Labels of the voxels as `nsm.shapes.volume_files.read_voxels` orders them, shape (i, j, k).

    Raises:
        InputError: If a package that the format needs is not installed, or the file cannot be written.
    """
    write = _WRITERS[volume_suffix(template)]
    with atomic_write(path) as temporary:
        write(temporary, template, labels)


def labels_suffix(template: Path) -> str:
    """Return the ending of files written like another one: its own, or that of a file in place of a header alone.

    >>> labels_suffix(Path("brain.NII.gz")), labels_suffix(Path("brain.nhdr"))
    ('.nii.gz', '.nrrd')
    """
    suffix = volume_suffix(template)
    return ".nrrd" if suffix == ".nhdr" else suffix


def _write_nibabel(path: Path, template: Path, labels: np.ndarray) -> None:
    require("nibabel", extra="medical", task=f"Writing {labels_suffix(template)}")
    import nibabel

    like: Any = nibabel.load(template)
    header = like.header.copy()
    header.set_data_dtype(labels.dtype)
    content = type(like)(labels, like.affine, header).to_bytes()
    path.write_bytes(gzip.compress(content, mtime=0) if volume_suffix(template) in (".nii.gz", ".mgz") else content)


def _write_nrrd(path: Path, template: Path, labels: np.ndarray) -> None:
    require("nrrd", extra="medical", task="Writing .nrrd")
    import nrrd

    header = {key: value for key, value in nrrd.read_header(str(template)).items() if key not in _FROM_VALUES}
    nrrd.write(str(path), labels, header)


def _write_tiff(path: Path, template: Path, labels: np.ndarray) -> None:
    require("tifffile", extra="medical", task="Writing .tif")
    import tifffile

    with tifffile.TiffFile(template) as like:
        imagej, first = like.imagej_metadata, like.pages[0].aspage()
        sizes = tuple(first.tags[name].value for name in ("XResolution", "YResolution") if name in first.tags)
    pages = np.ascontiguousarray(labels.T)
    if imagej is None:
        tifffile.imwrite(path, pages, photometric="minisblack")
        return
    kept: dict[str, Any] = {name: imagej[name] for name in ("spacing", "unit") if name in imagej}
    resolution: Any = sizes if len(sizes) == 2 else None
    tifffile.imwrite(path, pages, imagej=True, resolution=resolution, metadata=kept | {"axes": "ZYX"})


_WRITERS: dict[str, Callable[[Path, Path, np.ndarray], None]] = {
    ".nii": _write_nibabel,
    ".nii.gz": _write_nibabel,
    ".mgz": _write_nibabel,
    ".mgh": _write_nibabel,
    ".nrrd": _write_nrrd,
    ".nhdr": _write_nrrd,
    ".tif": _write_tiff,
    ".tiff": _write_tiff,
}
