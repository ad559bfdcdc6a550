"""NRRD: fields on a grid for 3D Slicer, ITK, and other programs for images.

References:
    https://teem.sourceforge.net/nrrd/format.html
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from nsm.cli.extras import require
from nsm.cli.files import atomic_write
from nsm.export.fields import SampledField


def write_nrrd_fields(folder: Path, number: int, sampled: SampledField) -> list[str]:
    """Write ``f_0000.nrrd`` with the signed distance, and ``velocity_0000.nrrd`` with vectors along its first axis.

    The header holds the place of the grid (``space origin`` and ``space directions``) and the time (``t``).

    Args:
        folder: The folder to write to.
        number: Number of the time, which becomes part of the names.
        sampled: The fields.

    Returns:
        The names of the files.

    Raises:
        InputError: If pynrrd is not installed, or a file cannot be written.
    """
    require("nrrd", extra="medical", task="Writing .nrrd")
    names = [f"f_{number:04d}.nrrd"]
    _write(folder / names[0], sampled.distance, "signed distance", sampled)
    if sampled.velocity is not None:
        names.append(f"velocity_{number:04d}.nrrd")
        _write(folder / names[1], sampled.velocity.movedim(-1, 0), "velocity per unit of t", sampled)
    return names


def _write(path: Path, values: Tensor, content: str, sampled: SampledField) -> None:
    import nrrd

    dim, vectors = len(sampled.lattice.shape), values.ndim - len(sampled.lattice.shape)
    directions = np.diag(sampled.lattice.step.double().cpu().numpy())
    header: dict[str, Any] = {
        "content": content,
        "kinds": ["vector"] * vectors + ["domain"] * dim,
        "space directions": np.vstack([np.full((vectors, dim), np.nan), directions]),
        "space origin": sampled.lattice.origin.double().cpu().numpy(),
        "t": f"{sampled.time:.17g}",
    }
    header |= {"space dimension": dim} if sampled.space is None else {"space": sampled.space}
    if sampled.unit is not None:
        header["space units"] = [sampled.unit] * dim
    with atomic_write(path) as temporary:
        nrrd.write(str(temporary), values.cpu().numpy(), header)
