"""Correspondences between the two ends of a morph, as numbers and as two meshes with the same colors."""

from __future__ import annotations

import io
import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from torch import Tensor

from nsm.cli.files import atomic_write
from nsm.io.mesh import write_mesh
from nsm.shapes.textured import Attributes
from nsm.types import SimplexMesh

log = logging.getLogger(__name__)


def write_correspondences(
    folder: Path,
    source: SimplexMesh,
    target: SimplexMesh,
    distances: Float[Tensor, " v"],
    colors: Float[Tensor, "v 3"],
    in_files: Mapping[str, Float[Tensor, "v d"]],
) -> None:
    """Write which point of the target each vertex of the source becomes.

    ``correspondences.npz`` holds ``source_points`` (v, d), ``target_points`` (v, d), ``distances`` (v,), and
    ``simplices`` (m, d); and ``source_in_file`` and ``target_in_file`` (v, d), the same points, each in the coordinates
    of its own file. ``source.ply`` and ``target.ply`` (OBJ in 2D) show corresponding points in the same color.

    Args:
        folder: The folder to write to.
        source: Mesh on the source.
        target: The same simplices on the target.
        distances: Distances between the advected vertices and the target.
        colors: Colors of the vertices, sRGB in 0..1.
        in_files: For ``source`` and ``target``, the vertices in the coordinates of the end's file.
    """
    suffix = "ply" if source.vertices.shape[1] == 3 else "obj"
    for name, mesh in (("source", source), ("target", target)):
        write_mesh(folder / f"{name}.{suffix}", mesh, attributes=Attributes(colors=colors))
    data = io.BytesIO()
    np.savez_compressed(
        data,
        source_points=source.vertices.cpu().numpy(),
        target_points=target.vertices.cpu().numpy(),
        distances=distances.cpu().numpy(),
        simplices=source.simplices.cpu().numpy(),
        source_in_file=in_files["source"].cpu().numpy(),
        target_in_file=in_files["target"].cpu().numpy(),
    )
    with atomic_write(folder / "correspondences.npz") as temporary:
        temporary.write_bytes(data.getbuffer())
    log.info(
        "wrote correspondences.npz, source.%s, and target.%s to %s (distance between advected vertices and the target: "
        "mean %.2g, maximum %.2g)",
        suffix,
        suffix,
        folder,
        float(distances.mean()),
        float(distances.max()),
    )
