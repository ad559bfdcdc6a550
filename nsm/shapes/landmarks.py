"""Landmarks: points of the source that are known to become certain points of the target."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
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


class LandmarkPairs(NamedTuple):
    """Points of the source (k, d), and where each goes on the target (k, d), both in the box."""

    source: Float[Tensor, "k d"]
    target: Float[Tensor, "k d"]


class Landmarks(ABC):
    """Pairs of points in the coordinates of the two shapes' files."""

    @abstractmethod
    def read(self, dim: int) -> LandmarkPairs:
        """The pairs as the files have them."""

    def place(self, source: FieldShape, target: FieldShape) -> LandmarkPairs:
        """The pairs in the box, carried there with the shapes: fit, pose and normalisation of volume.

        Raises:
            InputError: if there are none, or their dimension is not that of the shapes.
        """
        pairs = self.read(source.dim)
        return LandmarkPairs(
            *(
                shape.similarity.apply(points.double()).float()
                for shape, points in zip((source, target), pairs, strict=True)
            )
        )


class LandmarkTable(Landmarks):
    """A CSV with one pair a row: d coordinates on the source, then d on the target; a row of names may stand above.

    Args:
        path: the file.
    """

    def __init__(self, path: str) -> None:
        self.path = Path(path)

    def read(self, dim: int) -> LandmarkPairs:
        """The pairs of the file.

        Raises:
            InputError: if it cannot be read, or its rows are not 2 d numbers.
        """
        try:
            lines = [line.strip() for line in self.path.read_text().splitlines() if line.strip()]
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"landmarks.path={self.path} cannot be read ({error}): give a CSV file") from error
        rows = [_numbers(line) for line in lines]
        if rows and rows[0] is None:
            rows = rows[1:]
        wrong = next((number for number, row in enumerate(rows, 1) if row is None or len(row) != 2 * dim), None)
        if not rows or wrong is not None:
            where = "no rows" if not rows else f"no pair in row {wrong}"
            raise InputError(
                f"landmarks.path={self.path} has {where}: each row takes {2 * dim} numbers separated by commas, a "
                "point of the source and then its point of the target"
            )
        table = torch.tensor(rows, dtype=torch.float64)
        return LandmarkPairs(table[:, :dim], table[:, dim:])


class LandmarkVertices(Landmarks):
    """The same numbers of vertices on two meshes.

    Args:
        source_mesh, target_mesh: mesh files, in the coordinates of the shapes' files.
        source_vertices, target_vertices: their indices, counted from 0; None takes every vertex, in order.
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
        """The vertices.

        Raises:
            InputError: if a mesh cannot be read or lacks a vertex, or one list is longer than the other.
        """
        source, target = (_vertices(mesh, chosen) for mesh, chosen in zip(self.meshes, self.vertices, strict=True))
        if len(source) != len(target) or dim != source.shape[1]:
            raise InputError(
                f"landmarks are {len(source)} vertices of {self.meshes[0]} and {len(target)} of {self.meshes[1]}, for "
                f"shapes in {dim}D: name as many of the one as of the other, on meshes in 3D"
            )
        return LandmarkPairs(source, target)


def _numbers(line: str) -> list[float] | None:
    """The numbers of a row, None where there is anything else."""
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
        raise InputError(f"{path} cannot be read as a mesh ({error}): give landmarks on obj or ply files") from error
    if not isinstance(mesh, trimesh.Trimesh):
        raise InputError(f"{path} holds no triangles: give landmarks on obj or ply files of meshes")
    points = torch.as_tensor(np.asarray(mesh.vertices))
    if chosen is None:
        return points
    lost = [index for index in chosen if not 0 <= index < len(points)]
    if lost:
        raise InputError(f"{path} has {len(points)} vertices, and landmarks name number {lost[0]}: count from 0")
    return points[torch.as_tensor(list(chosen), dtype=torch.long)]
