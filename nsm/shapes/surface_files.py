"""Reading of surfaces in formats of visualization (VTK) and neuroimaging (GIFTI, FreeSurfer)."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from nsm.cli.extras import require

#: Extensions of VTK files, legacy and XML.
VTK_FORMATS = (".vtk", ".vtp", ".vtu")
#: Extensions of surfaces of the brain.
BRAIN_FORMATS = (".gii", ".pial", ".white")
#: Extensions of supported files.
SURFACE_FORMATS = (*VTK_FORMATS, *BRAIN_FORMATS)


def read_surface(file: Path) -> trimesh.Trimesh:
    """Read triangles in the coordinates of the file; polygons are triangulated, and cells contribute their boundary.

    Raises:
        InputError: If the package that reads the format is not installed.
    """
    vertices, faces = _vtk(file) if file.suffix.lower() in VTK_FORMATS else _brain(file)
    return trimesh.Trimesh(vertices, faces, process=False)


def _vtk(file: Path) -> tuple[np.ndarray, np.ndarray]:
    require("pyvista", extra="render", task=f"Reading {file.suffix.lower()}")
    import pyvista

    with warnings.catch_warnings():  # VTK warns about damaged files and returns nothing
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
