"""Shapes from point clouds."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Sequence
from copy import copy
from typing import Any

import igl
import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.volume import volume
from nsm.shapes.base import Shape, working_box
from nsm.shapes.download import file_sha256, resolve
from nsm.shapes.mesh_reading import LEAST_WINDING
from nsm.shapes.orientation import PLANE_NEIGHBORS, estimate_normals, find_rims
from nsm.shapes.placing import FilePlacement, centered
from nsm.shapes.point_files import read_points
from nsm.shapes.primitive import Pose
from nsm.shapes.sampling import ambient_points
from nsm.shapes.similarity import Similarity
from nsm.types import DistanceSamples, SurfaceSamples

log = logging.getLogger(__name__)

#: Neighbours that the area of a point is estimated from.
NEIGHBOURS = 12
#: Within so many radii of its disc the nearest point tells the side; beyond, the winding number does.
NEAR_RADII = 4.0
#: Cells along the longest side for the volume.
VOLUME_CELLS = 96
#: Least fall of the winding number across the points: about 1 where neighbours agree, and near 0 where they do not.
LEAST_JUMP = 0.3


class PointCloud(Shape):
    """Points on a surface: every point stands for a disc of it, across its normal.

    Normals that the file lacks are estimated, oriented, and judged in the log (`nsm.shapes.orientation`).

    The area of a disc is that which its nearest neighbours leave it. A distance is that to the disc of the
    nearest point p with normal n and radius ρ: with h = ⟨x − p, n⟩ and ℓ² = |x − p|² − h², it is
    √(h² + max(ℓ − ρ, 0)²), so close to the surface it is the distance to the tangent plane. The side is that of h
    there and that of the winding number of the discs (Barill et al., SIGGRAPH 2018) farther out.

    Args:
        path: a ply, xyz, txt, npy, las, or laz file, or a public name; normals are nx, ny, nz or columns 4 to 6.
        fit: half of the longest side after fitting; None keeps the coordinates of the file.
        pose: rotation, translation and scale given to the points after that.
        up: the direction in the coordinates of the file that becomes +y, before all else; None if it is +y already.

    Raises:
        InputError: if the file cannot be read, or the normals enclose nothing.
    """

    dim = 3

    def __init__(
        self, path: str, fit: float | None = 0.8, pose: Pose = None, up: Sequence[float] | None = None
    ) -> None:
        place, file = FilePlacement(fit, pose, up), resolve(path)
        name, columns = str(path), read_points(file)
        self.path, self._sha256, self._estimated = name, file_sha256(file), columns.normals is None
        raw, given = clean_points(*columns, self.path)
        points, center = centered(torch.from_numpy(raw))
        orientation = estimate_normals(points.numpy()) if given is None else None
        normals = given if orientation is None else orientation.normals
        placement = place.of_centered(points, center)
        self._similarity = placement.after(Similarity.shift(-center))
        self._points = placement.apply(points).numpy()
        self._normals = placement.turn(torch.from_numpy(normals)).numpy()
        self._tree = cKDTree(self._points)
        self._areas = point_areas(self._tree)
        self._radii = np.sqrt(self._areas / np.pi)
        self._expansion: tuple[Any, ...] | None = None
        steady = self._orient()
        if orientation is not None:
            log.info(
                "%s has no normals: they are estimated from %d neighbors each and turned alike along a spanning tree "
                "(%d pieces); %.1f %% of the neighbors agree, and the winding number confirms the side of %.1f %%",
                *(name, PLANE_NEIGHBORS, orientation.pieces, 100 * orientation.agreement, 100 * steady),
            )
        rims = find_rims(self._points, self._normals)
        if rims.holes:
            log.warning(
                "%s is a partial cloud: %d of its %d points lie at the rims of about %d holes, which the network that "
                "is fitted to it closes",
                *(name, rims.points, len(self._points), rims.holes),
            )

    def transformed(self, similarity: Similarity) -> PointCloud:
        """The cloud moved by a similarity, on top of what it has."""
        moved = copy(self)
        moved._similarity = similarity.after(self._similarity)
        moved._points = similarity.apply(torch.from_numpy(self._points)).numpy()
        moved._normals = similarity.turn(torch.from_numpy(self._normals)).numpy()
        moved._tree, moved._expansion = cKDTree(moved._points), None
        moved._areas, moved._radii = similarity.scale**2 * self._areas, similarity.scale * self._radii
        return moved

    def surface_samples(self, count: int, generator: torch.Generator) -> SurfaceSamples:
        """A random subset of the points (repeated only if more are asked for than there are), with their normals."""
        n = len(self._points)
        chosen = torch.cat([torch.randperm(n, generator=generator) for _ in range(-(-count // n))])[:count]
        dtype = torch.get_default_dtype()
        points, normals = torch.from_numpy(self._points)[chosen], torch.from_numpy(self._normals)[chosen]
        return SurfaceSamples(points.to(dtype), normals.to(dtype))

    def distance_samples(
        self, count: int, generator: torch.Generator, bounds: Float[Tensor, "2 d"] | None = None
    ) -> DistanceSamples:
        """Points with distances to the discs of the nearest points."""
        surface = self.surface_samples(max(count // 2, 1), generator).points
        points = ambient_points(surface, count, generator, working_box(3) if bounds is None else bounds)
        return DistanceSamples(points, self.signed_distance(points))

    def signed_distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Signed distance (n,) at x (n, 3) in the box."""
        queries = x.detach().cpu().double().numpy()
        reach, nearest = self._tree.query(queries)
        height = np.einsum("ij,ij->i", queries - self._points[nearest], self._normals[nearest])
        lateral = np.sqrt(np.maximum(reach**2 - height**2, 0))
        radius = self._radii[nearest]
        distance = np.hypot(height, np.maximum(lateral - radius, 0))
        inside = height < 0
        far = reach > NEAR_RADII * radius
        inside[far] = self._winding(queries[far]) > 0.5
        return torch.from_numpy(np.where(inside, -distance, distance)).to(x)

    def exact_bounds(self) -> Float[Tensor, "2 d"]:
        """Corners of the box around the points."""
        points = torch.from_numpy(self._points)
        return torch.stack([points.amin(0), points.amax(0)])

    def volume(self) -> float:
        """Volume of the inside, from a grid."""
        low, high = self.exact_bounds()
        margin = 0.05 * (high - low).max()
        return volume(self.signed_distance, torch.stack([low - margin, high + margin]), VOLUME_CELLS)

    def provenance(self) -> dict[str, Any]:
        """File, hash and the similarity from its coordinates to the box."""
        return {
            "kind": "point cloud",
            "path": self.path,
            "sha256": self._sha256,
            "normals": "estimated" if self._estimated else "given",
            "similarity": self._similarity.to_config(),
        }

    def content_key(self) -> str:
        """SHA-256 of the content of the file and its way to the box, whatever the name of the file."""
        place = json.dumps(self._similarity.to_config(), sort_keys=True)
        return hashlib.sha256(f"{type(self).__name__} {self._sha256} {place}".encode()).hexdigest()

    def _winding(self, queries: np.ndarray) -> np.ndarray:
        if not len(queries):
            return np.zeros(0)
        if self._expansion is None:
            cells, children = igl.octree(self._points)[:2]
            cloud = (self._points, self._normals, self._areas, cells, children)
            self._expansion = (*cloud, *igl.fast_winding_number_precompute(*cloud))
        return igl.fast_winding_number(*self._expansion, queries)

    def _orient(self, count: int = 4000) -> float:
        """Bring the areas to scale and the normals outwards, by the winding number on both sides of the points.

        It falls by 1 across the discs whatever way they are turned; its mean below them is 1 if they point outwards, 0
        if inwards, and about 1/2 if they contradict each other or enclose nothing.
        """
        draw = torch.randperm(len(self._points), generator=torch.Generator().manual_seed(0))[:count].numpy()
        offset = NEAR_RADII * self._radii[draw, None] * self._normals[draw]
        below = self._winding(self._points[draw] - offset)
        above = self._winding(self._points[draw] + offset)
        jump = float(np.median(below - above))
        beneath = float(np.median(below)) / jump if jump > 0 else 0.5
        if jump < LEAST_JUMP or max(beneath, 1 - beneath) < LEAST_WINDING:
            raise InputError(
                f"The normals of {self.path} enclose nothing (their winding number falls by {jump:.2f} across the "
                "points, where 1 is right): give a closed cloud whose normals all point outwards."
            )
        self._areas = self._areas / jump
        if beneath < 0.5:
            log.warning("the normals of %s point inwards: they are turned", self.path)
            self._normals = -self._normals
        self._expansion = None
        steady = float(((below / jump > 0.5) == (beneath > 0.5)).mean())
        if steady < 0.9:
            log.warning(
                "%.0f %% of the normals of %s contradict the others: distances there may have the wrong sign",
                *(100 * (1 - steady), self.path),
            )
        return steady


def clean_points(points: np.ndarray, normals: np.ndarray | None, name: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Distinct points, with unit normals if there are normals; points whose normal is zero are dropped.

    Raises:
        InputError: for too few points, numbers that are not finite, or a flat cloud.
    """
    rows = points if normals is None else np.concatenate([points, normals], 1)
    if bad := int((~np.isfinite(rows)).any(1).sum()):
        raise InputError(f"{name} has {bad} points or normals that are not finite numbers: repair or export it again.")
    if normals is not None:
        length = np.linalg.norm(normals, axis=1)
        if lost := int((length < 1e-6).sum()):
            log.warning("%d of %d points of %s have no normal and are left out", lost, len(points), name)
        points, normals = points[length >= 1e-6], normals[length >= 1e-6] / length[length >= 1e-6, None]
    points, first = np.unique(points, axis=0, return_index=True)
    if len(points) < 4 * NEIGHBOURS:
        with_normals = "" if normals is None else " with normals"
        raise InputError(
            f"{name} must have {4 * NEIGHBOURS} distinct points{with_normals} or more, got {len(points)}. Try a denser "
            "cloud."
        )
    return points, None if normals is None else normals[first]


def point_areas(tree: cKDTree) -> np.ndarray:
    """Area (n,) of each point, up to a common factor: π r² / k with r the distance of its k-th neighbour."""
    distance, _ = tree.query(tree.data, k=NEIGHBOURS + 1)
    return np.pi * distance[:, -1] ** 2 / NEIGHBOURS
