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
from nsm.shapes.mesh_reading import MIN_WINDING
from nsm.shapes.orientation import PLANE_NEIGHBORS, estimate_normals, find_rims
from nsm.shapes.placing import FilePlacement, centered
from nsm.shapes.point_files import read_points
from nsm.shapes.sampling import ambient_points
from nsm.shapes.similarity import Pose, Similarity
from nsm.types import DistanceSamples, SurfaceSamples

log = logging.getLogger(__name__)

#: Number of neighbors from which the area of a point is estimated.
_NEIGHBORS = 12
#: Distance, in radii of its disk, within which the nearest point determines the sign; beyond, the winding number does.
_NEAR_RADII = 4.0
#: Number of cells along the longest side on which the volume is measured.
_VOLUME_CELLS = 96
#: Minimum jump of the winding number across the points: about 1 for consistent normals, and near 0 otherwise.
_MIN_JUMP = 0.3


class PointCloud(Shape):
    """Points on a surface, each of which represents a disk orthogonal to its normal.

    Normals missing from the file are estimated and oriented, and the log reports their quality
    (`nsm.shapes.orientation`).

    The area of a disk follows from the distances to its nearest neighbors. The distance at x is that to the disk of the
    nearest point p with normal n and radius ρ: with h = ⟨x − p, n⟩ and ℓ² = ‖x − p‖² − h², it is
    √(h² + max(ℓ − ρ, 0)²), which near the surface is the distance to the tangent plane. The sign is that of h near the
    surface, and follows from the winding number of the disks farther away.

    Args:
        path: A ply, xyz, txt, npy, las, or laz file, or a public name; normals are nx, ny, nz, or columns 4 to 6.
        fit: Half the longest side of the bounding box after fitting; None keeps the coordinates of the file.
        pose: Rotation, translation, and scale applied after fitting.
        up: Direction in the coordinates of the file that becomes +y, before all else; None for +y.

    Raises:
        InputError: If the file cannot be read, or the normals do not enclose a volume.

    References:
        Barill et al., Fast Winding Numbers for Soups and Clouds, SIGGRAPH 2018.
        https://doi.org/10.1145/3197517.3201337
    """

    dim = 3

    def __init__(
        self, path: str, fit: float | None = 0.8, pose: Pose = None, up: Sequence[float] | None = None
    ) -> None:
        file_placement, file = FilePlacement(fit, pose, up), resolve(path)
        name, columns = str(path), read_points(file)
        self.path, self._sha256, self._estimated = name, file_sha256(file), columns.normals is None
        raw, given = clean_points(*columns, self.path)
        points, center = centered(torch.from_numpy(raw))
        orientation = estimate_normals(points.numpy()) if given is None else None
        normals = given if orientation is None else orientation.normals
        placement = file_placement.of_centered(points, center)
        self._similarity = placement.after(Similarity.shift(-center))
        self._points = placement.apply(points).numpy()
        self._normals = placement.rotate(torch.from_numpy(normals)).numpy()
        self._tree = cKDTree(self._points)
        self._areas = point_areas(self._tree)
        self._radii = np.sqrt(self._areas / np.pi)
        self._expansion: tuple[Any, ...] | None = None
        consistent = self._orient()
        if orientation is not None:
            log.info(
                "%s has no normals: they are estimated from %d neighbors each and oriented along a spanning tree "
                "(%d components); %.1f %% of the neighbors agree, and the winding number confirms the side of %.1f %%",
                *(name, PLANE_NEIGHBORS, orientation.pieces, 100 * orientation.agreement, 100 * consistent),
            )
        rims = find_rims(self._points, self._normals)
        if rims.holes:
            log.warning(
                "%s is a partial cloud: %d of its %d points lie at the rims of about %d holes, which a network fitted "
                "to it closes",
                *(name, rims.points, len(self._points), rims.holes),
            )

    def transformed(self, similarity: Similarity) -> PointCloud:
        """Apply a similarity after the present pose of the cloud, and return the result as a new shape."""
        moved = copy(self)
        moved._similarity = similarity.after(self._similarity)
        moved._points = similarity.apply(torch.from_numpy(self._points)).numpy()
        moved._normals = similarity.rotate(torch.from_numpy(self._normals)).numpy()
        moved._tree, moved._expansion = cKDTree(moved._points), None
        moved._areas, moved._radii = similarity.scale**2 * self._areas, similarity.scale * self._radii
        return moved

    def surface_samples(self, count: int, generator: torch.Generator) -> SurfaceSamples:
        """Choose a random subset of the points with their normals; points repeat only if there are too few."""
        n = len(self._points)
        chosen = torch.cat([torch.randperm(n, generator=generator) for _ in range(-(-count // n))])[:count]
        dtype = torch.get_default_dtype()
        points, normals = torch.from_numpy(self._points)[chosen], torch.from_numpy(self._normals)[chosen]
        return SurfaceSamples(points.to(dtype), normals.to(dtype))

    def distance_samples(
        self, count: int, generator: torch.Generator, bounds: Float[Tensor, "2 d"] | None = None
    ) -> DistanceSamples:
        """Sample points with distances to the disks of the nearest points."""
        surface = self.surface_samples(max(count // 2, 1), generator).points
        points = ambient_points(surface, count, generator, working_box(3) if bounds is None else bounds)
        return DistanceSamples(points, self.signed_distance(points))

    def signed_distance(self, x: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Evaluate the signed distance, shape (n,), at points in the box, shape (n, 3)."""
        queries = x.detach().cpu().double().numpy()
        reach, nearest = self._tree.query(queries)
        height = np.einsum("ij,ij->i", queries - self._points[nearest], self._normals[nearest])
        lateral = np.sqrt(np.maximum(reach**2 - height**2, 0))
        radius = self._radii[nearest]
        distance = np.hypot(height, np.maximum(lateral - radius, 0))
        inside = height < 0
        far = reach > _NEAR_RADII * radius
        inside[far] = self._winding(queries[far]) > 0.5
        return torch.from_numpy(np.where(inside, -distance, distance)).to(x)

    def exact_bounds(self) -> Float[Tensor, "2 d"]:
        """Compute the bounding box of the points."""
        points = torch.from_numpy(self._points)
        return torch.stack([points.amin(0), points.amax(0)])

    def volume(self) -> float:
        """Compute the volume of the inside on a grid."""
        low, high = self.exact_bounds()
        margin = 0.05 * (high - low).max()
        return volume(self.signed_distance, torch.stack([low - margin, high + margin]), _VOLUME_CELLS)

    def provenance(self) -> dict[str, Any]:
        """Return file, checksum, origin of the normals, and the similarity from the file to the box."""
        return {
            "kind": "point cloud",
            "path": self.path,
            "sha256": self._sha256,
            "normals": "estimated" if self._estimated else "given",
            "similarity": self._similarity.to_config(),
        }

    def content_key(self) -> str:
        """Hash the content of the file and its similarity with SHA-256, independently of the name of the file."""
        similarity = json.dumps(self._similarity.to_config(), sort_keys=True)
        return hashlib.sha256(f"{type(self).__name__} {self._sha256} {similarity}".encode()).hexdigest()

    def _winding(self, queries: np.ndarray) -> np.ndarray:
        if not len(queries):
            return np.zeros(0)
        if self._expansion is None:
            cells, children = igl.octree(self._points)[:2]
            cloud = (self._points, self._normals, self._areas, cells, children)
            self._expansion = (*cloud, *igl.fast_winding_number_precompute(*cloud))
        return igl.fast_winding_number(*self._expansion, queries)

    def _orient(self, count: int = 4000) -> float:
        """Scale the areas and orient the normals by the winding number on both sides of the points.

        The winding number decreases by 1 across correctly scaled disks. Below the disks it is 1 if normals point
        outward, 0 if they point inward, and about 1/2 if they are inconsistent or enclose no volume.
        """
        draw = torch.randperm(len(self._points), generator=torch.Generator().manual_seed(0))[:count].numpy()
        offset = _NEAR_RADII * self._radii[draw, None] * self._normals[draw]
        below = self._winding(self._points[draw] - offset)
        above = self._winding(self._points[draw] + offset)
        jump = float(np.median(below - above))
        inside = float(np.median(below)) / jump if jump > 0 else 0.5
        if jump < _MIN_JUMP or max(inside, 1 - inside) < MIN_WINDING:
            raise InputError(
                f"`{self.path}` must have normals that enclose a volume, got normals whose winding number decreases by "
                f"{jump:.2f} across the points, where 1 is correct. Try a closed cloud whose normals all point outward."
            )
        self._areas = self._areas / jump
        if inside < 0.5:
            log.warning("the normals of %s point inward; they are flipped", self.path)
            self._normals = -self._normals
        self._expansion = None
        consistent = float(((below / jump > 0.5) == (inside > 0.5)).mean())
        if consistent < 0.9:
            log.warning(
                "%.0f %% of the normals of %s contradict the others, so distances there may have the wrong sign",
                *(100 * (1 - consistent), self.path),
            )
        return consistent


def clean_points(points: np.ndarray, normals: np.ndarray | None, name: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Remove duplicate points and points whose normal is zero, and normalize the normals if there are any.

    Args:
        points: Points, shape (n, 3).
        normals: Normals of any length, shape (n, 3), or None.
        name: Name of the file, for messages.

    Raises:
        InputError: If a number is not finite, or too few points remain.
    """
    rows = points if normals is None else np.concatenate([points, normals], 1)
    if bad := int((~np.isfinite(rows)).any(1).sum()):
        raise InputError(f"`{name}` must have finite points and normals, got {bad} not finite. Try to export it again.")
    if normals is not None:
        length = np.linalg.norm(normals, axis=1)
        if lost := int((length < 1e-6).sum()):
            log.warning("%d of %d points of %s have no normal and are ignored", lost, len(points), name)
        points, normals = points[length >= 1e-6], normals[length >= 1e-6] / length[length >= 1e-6, None]
    points, first = np.unique(points, axis=0, return_index=True)
    if len(points) < 4 * _NEIGHBORS:
        with_normals = "" if normals is None else " with normals"
        raise InputError(
            f"`{name}` must have at least {4 * _NEIGHBORS} distinct points{with_normals}, got {len(points)}. Try a "
            "denser cloud."
        )
    return points, None if normals is None else normals[first]


def point_areas(tree: cKDTree) -> np.ndarray:
    """Estimate the area of each point up to a common factor, π r² / k for the distance r of its k-th neighbor."""
    distance, _ = tree.query(tree.data, k=_NEIGHBORS + 1)
    return np.pi * distance[:, -1] ** 2 / _NEIGHBORS
