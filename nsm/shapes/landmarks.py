"""Landmarks: corresponding points of source and target."""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.shapes.base import FieldShape
from nsm.shapes.download import resolve

log = logging.getLogger(__name__)

#: Distance of a landmark from the surface of its shape, in the box, above which its coordinates may be another file's.
_FAR = 0.1
#: Number of landmarks that a checkpoint keeps, spread over the list.
_KEPT = 5000


class LandmarkPairs(NamedTuple):
    """Corresponding points, in the coordinates of the files of their shapes or in those of the box.

    Attributes:
        source: Points of the source, shape (k, d).
        target: Corresponding points of the target, shape (k, d).
    """

    source: Float[Tensor, "k d"]
    target: Float[Tensor, "k d"]

    def place(self, source: FieldShape, target: FieldShape) -> LandmarkPairs:
        """Map landmarks from the coordinates of the files to the box, with the similarities of the shapes."""
        ends = zip((source, target), self, strict=True)
        return LandmarkPairs(*(shape.similarity.apply(points.double()).float() for shape, points in ends))

    def provenance(self) -> dict[str, list[list[float]]]:
        """Plain values from which `read_provenance` makes landmarks, at most 5000 of them, evenly spread."""
        stride = math.ceil(len(self.source) / _KEPT)
        return {"source": self.source[::stride].tolist(), "target": self.target[::stride].tolist()}

    @classmethod
    def read_provenance(cls, values: Mapping[str, Sequence[Sequence[float]]]) -> LandmarkPairs:
        """Read what `provenance` returns."""
        return cls(*(torch.tensor(values[end], dtype=torch.float64) for end in ("source", "target")))


class Landmarks(ABC):
    """Corresponding points in the coordinates of the files of both shapes."""

    @abstractmethod
    def read(self, dim: int) -> LandmarkPairs:
        """Read the landmarks in the coordinates of the files.

        Args:
            dim: Dimension d of the shapes.

        Raises:
            InputError: If a file cannot be read, there are no landmarks, or their dimension is not that of the shapes.
        """


def warn_of_distant(landmarks: LandmarkPairs, source: FieldShape, target: FieldShape) -> None:
    """Warn of landmarks in the box that lie far from the surfaces of their shapes."""
    for end, shape, points in zip(("source", "target"), (source, target), landmarks, strict=True):
        distances = shape.true_distance(points).abs()
        if distances.max() > _FAR:
            log.warning(
                "Landmark %d lies %.2g from the surface of the %s, in a box where the shapes are 0.9 large. Landmarks "
                "must have the coordinates of the file of their shape.",
                int(distances.argmax()) + 1,
                float(distances.max()),
                end,
            )


class LandmarkTable(Landmarks):
    """Landmarks from a CSV file with rows of d coordinates on the source, then d on the target.

    Args:
        path: The file, whose first row may contain names.
    """

    def __init__(self, path: str) -> None:
        self.path = Path(path)

    def read(self, dim: int) -> LandmarkPairs:
        try:
            lines = [line.strip() for line in self.path.read_text().splitlines() if line.strip()]
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(
                f"`landmarks.path` must be a readable CSV file, got {self.path} ({error}). Try "
                "`landmarks.path=FILE.csv`."
            ) from error
        rows = [_numbers(line) for line in lines]
        if rows and rows[0] is None:
            rows = rows[1:]
        wrong = next((number for number, row in enumerate(rows, 1) if row is None or len(row) != 2 * dim), None)
        if not rows or wrong is not None:
            found = "no rows" if not rows else f"other content in row {wrong}"
            raise InputError(
                f"`landmarks.path` must have {2 * dim} numbers in each row, a point of the source and its point of the "
                f"target, got {found} in {self.path}. Try rows such as `{','.join(['0.1'] * 2 * dim)}`."
            )
        table = torch.tensor(rows, dtype=torch.float64)
        return LandmarkPairs(table[:, :dim], table[:, dim:])


class LandmarkPoints(Landmarks):
    """Landmarks given one by one.

    Args:
        source: Points of the source, k of d coordinates.
        target: Points of the target, one for each of the source.

    Example:
        >>> LandmarkPoints([[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.5], [2.0, 0.5]]).read(2).target.tolist()
        [[0.0, 0.5], [2.0, 0.5]]
    """

    def __init__(self, source: Sequence[Sequence[float]], target: Sequence[Sequence[float]]) -> None:
        self.points = {"source": source, "target": target}

    def read(self, dim: int) -> LandmarkPairs:
        """Return the landmarks.

        Raises:
            InputError: If there are none, the numbers of points differ, or one does not have d finite coordinates.
        """
        example = [[0.1] * dim]
        for end, points in self.points.items():
            if not points or not all(len(point) == dim and all(map(math.isfinite, point)) for point in points):
                raise InputError(
                    f"`landmarks.{end}` must be a list of points of {dim} finite coordinates each, got {points}. "
                    f"Try `landmarks.{end}={example}`."
                )
        source, target = (torch.tensor(points, dtype=torch.float64) for points in self.points.values())
        if len(source) != len(target):
            raise InputError(
                f"`landmarks.target` must have a point for each of the {len(source)} of the source, got {len(target)}. "
                f"Try `landmarks.source={example}` and `landmarks.target={example}`."
            )
        return LandmarkPairs(source, target)


class LandmarkVertices(Landmarks):
    """Landmarks at vertices of two meshes.

    Args:
        source_mesh, target_mesh: Mesh files, in the coordinates of the files of the shapes.
        source_vertices, target_vertices: Indices of corresponding vertices, starting at 0; None for all in order.
    """

    def __init__(
        self,
        source_mesh: str,
        target_mesh: str,
        source_vertices: Sequence[int] | None = None,
        target_vertices: Sequence[int] | None = None,
    ) -> None:
        self.meshes = (source_mesh, target_mesh)
        self.vertices = (source_vertices, target_vertices)

    def read(self, dim: int) -> LandmarkPairs:
        source, target = (_vertices(mesh, chosen) for mesh, chosen in zip(self.meshes, self.vertices, strict=True))
        if len(source) != len(target) or dim != source.shape[1]:
            raise InputError(
                "`landmarks` must be equally many vertices of two meshes of 3D shapes, got "
                f"{len(source)} of {self.meshes[0]} and {len(target)} of {self.meshes[1]} for shapes in {dim}D. Try "
                "`landmarks.source_vertices=[0,1]` and `landmarks.target_vertices=[0,1]`."
            )
        return LandmarkPairs(source, target)


def _numbers(line: str) -> list[float] | None:
    """Parse the finite numbers of a row, or return None if there is anything else."""
    try:
        numbers = [float(cell) for cell in line.split(",")]
    except ValueError:
        return None
    return numbers if all(math.isfinite(number) for number in numbers) else None


def _vertices(path: str, chosen: Sequence[int] | None) -> Float[Tensor, "k 3"]:
    file = resolve(path)
    try:
        mesh = trimesh.load(file, process=False, maintain_order=True, force="mesh")
    except (OSError, ValueError, KeyError, IndexError) as error:
        raise InputError(
            f"`landmarks` must refer to obj or ply files, got {path} ({error}). Try to export the mesh again."
        ) from error
    if not isinstance(mesh, trimesh.Trimesh):
        raise InputError(f"`landmarks` must refer to meshes with triangles, got {path} without. Try an obj file.")
    points = torch.as_tensor(np.asarray(mesh.vertices))
    if chosen is None:
        return points
    lost = [index for index in chosen if not 0 <= index < len(points)]
    if lost:
        raise InputError(
            f"`landmarks` must refer to vertices 0 to {len(points) - 1} of {path}, got {lost[0]}. Try indices from 0."
        )
    return points[torch.as_tensor(list(chosen), dtype=torch.long)]
