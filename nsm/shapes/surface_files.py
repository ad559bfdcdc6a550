"""Surfaces in the formats of visualization (VTK) and neuroimaging (GIFTI, FreeSurfer)."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from nsm.cli.extras import require

#: Endings of files of VTK, legacy and XML.
VTK_FORMATS = (".vtk", ".vtp", ".vtu")
#: Endings of surfaces of the brain.
BRAIN_FORMATS = (".gii", ".pial", ".white")
#: Endings of files that can be read.
SURFACE_FORMATS = (*VTK_FORMATS, *BRAIN_FORMATS)


def read_surface(file: Path) -> trimesh.Trimesh:
    """Read the triangles of a file in its own coordinates; polygons are cut into triangles, and cells give their hull.

    Raises:
        InputError: If the package that reads the format is not installed.
    """
    vertices, faces = _vtk(file) if file.suffix.lower() in VTK_FORMATS else _brain(file)
    return trimesh.Trimesh(vertices, faces, process=False)


def _vtk(file: Path) -> tuple[np.ndarray, np.ndarray]:
    require("pyvista", extra="render", task=f"Reading {file.suffix.lower()}")
    import pyvista

    with warnings.catch_warnings():  # of a damaged file VTK warns, and gives nothing
        warnings.simplefilter("ignore")
        data = pyvista.read(file)
    if isinstance(data, pyvista.MultiBlock):
        data = data.combine()
    surface = data if isinstance(data, pyvista.PolyData) else data.extract_surface(algorithm="dataset_surface")
    triangles = surface.triangulate()
    return np.asarray(triangles.points, dtype=np.float64), triangles.faces.reshape(-1, 4)[:, 1:]


def _brain(file: Path) -> tuple[np.ndarray, np.ndarray]:
    require("nibabel", extra="medical", task=f"Reading {file.suffix.lower()}")
    import nibabel

    if file.suffix.lower() == ".gii":
        image: Any = nibabel.load(file)
        points, triangles = image.agg_data("pointset"), image.agg_data("triangle")
    else:
        points, triangles = nibabel.freesurfer.read_geometry(file)
    return np.asarray(points, dtype=np.float64), np.asarray(triangles, dtype=np.int64)
