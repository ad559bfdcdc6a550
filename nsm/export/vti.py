"""VTK image data: fields on a grid for ParaView and other programs of VTK.

References:
    https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from torch import Tensor

from nsm.cli.extras import require
from nsm.cli.files import atomic_write
from nsm.export.fields import SampledField


def write_vti_fields(folder: Path, number: int, sampled: SampledField) -> list[str]:
    """Write ``fields_0000.vti`` with the point data ``f`` and ``velocity``, and the time as ``TimeValue``.

    In 2D the grid lies in the plane z = 0, and vectors have a third component of 0.

    Args:
        folder: The folder to write to.
        number: Number of the time, which becomes part of the name.
        sampled: The fields.

    Returns:
        The name of the file, in a list.

    Raises:
        InputError: If PyVista is not installed, or the file cannot be written.
    """
    require("pyvista", extra="render", task="Writing .vti")
    import pyvista

    lattice, missing = sampled.lattice, 3 - len(sampled.lattice.shape)
    image = pyvista.ImageData(
        dimensions=(*lattice.shape, *[1] * missing),
        spacing=(*lattice.step.tolist(), *[1.0] * missing),
        origin=(*lattice.origin.tolist(), *[0.0] * missing),
    )
    image.point_data["f"] = _first_axis_fastest(sampled.distance[..., None])[:, 0]
    if sampled.velocity is not None:
        image.point_data["velocity"] = np.pad(_first_axis_fastest(sampled.velocity), ((0, 0), (0, missing)))
        image.point_data.active_vectors_name = "velocity"
    image.point_data.active_scalars_name = "f"
    image.field_data["TimeValue"] = [sampled.time]
    name = f"fields_{number:04d}.vti"
    with atomic_write(folder / name) as temporary:
        image.save(temporary)
    return [name]


def _first_axis_fastest(values: Tensor) -> np.ndarray:
    """Flatten values (*shape, m) on a grid to (n, m), in the order of VTK."""
    axes = range(values.ndim - 2, -1, -1)
    return values.permute(*axes, values.ndim - 1).reshape(-1, values.shape[-1]).cpu().numpy()
