"""The surface of a labeled region, which encloses the volume of its voxels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d, maximum_filter
from scipy.optimize import brentq
from skimage.measure import marching_cubes

from nsm.shapes.mesh_reading import signed_volume

#: Standard deviation, in voxels, of the Gaussian that rounds the steps between voxels.
SMOOTHING = 1.0
#: Change of the indicator at the center of a voxel above which smoothing is not applied there, because it would move
#: the surface past the voxel: at walls and rods one voxel thick (−0.12 and −0.35), and at corners (−0.17).
STEEP = 0.1
#: Bounds on the level that gives the surface its volume; 0 is the mean of inside and outside.
LEVELS = (-0.45, 0.45)
#: Number of outside voxels around the region.
PADDING = 4


class LabelSurface(NamedTuple):
    """A closed surface around voxels.

    Attributes:
        vertices: Vertices in indices of voxels, whose centers are integers, shape (v, 3).
        faces: Triangles with outward normals, shape (m, 3).
    """

    vertices: np.ndarray
    faces: np.ndarray


def label_surface(mask: np.ndarray) -> LabelSurface:
    """Extract the boundary of a set of voxels, with sub-voxel accuracy.

    The indicator of the set, ±1/2, is smoothed by a Gaussian of one voxel, except where that would lose thin parts.
    Because smoothing shrinks curved parts, the level is not 0 but the one whose surface encloses the total volume of
    the voxels, which is the unbiased estimate. On balls of 8 to 30 voxels the error of the surface is 0.07 voxels
    (RMS), compared with 0.2 voxels without smoothing.

    Args:
        mask: Whether each voxel belongs to the region, shape (i, j, k); at least one does.
    """
    filled = [np.flatnonzero(mask.any(axis=tuple(other for other in range(3) if other != axis))) for axis in range(3)]
    low = np.array([indices[0] for indices in filled])
    region = mask[tuple(slice(indices[0], indices[-1] + 1) for indices in filled)]
    field = _smoothed(np.pad(region, PADDING))
    count = int(region.sum())

    def excess(level: float) -> float:
        return abs(signed_volume(*_marched(field, level))) - count

    ends = [excess(level) for level in LEVELS]
    if ends[0] * ends[1] < 0:
        level = float(brentq(excess, *LEVELS, xtol=1e-5))
    else:
        level = LEVELS[int(abs(ends[1]) < abs(ends[0]))]
    vertices, faces = _marched(field, level)
    if signed_volume(vertices, faces) < 0:
        faces = faces[:, ::-1].copy()
    return LabelSurface(vertices + low - PADDING, faces)


def _smoothed(mask: np.ndarray) -> np.ndarray:
    steps = np.where(mask, 0.5, -0.5).astype(np.float32)
    smooth = gaussian_filter(steps, SMOOTHING)
    lost = maximum_filter(2 * smooth * steps < -STEEP, 3)
    smooth /= gaussian_filter1d([0] * 9 + [1.0] + [0] * 9, SMOOTHING)[9]  # ±1/2 again beside planes
    kept = np.maximum(gaussian_filter(lost.astype(np.float32), SMOOTHING), lost)
    return smooth + kept * (steps - smooth)


def _marched(field: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces, _, _ = marching_cubes(field, level)
    return vertices.astype(np.float64), faces.astype(np.int64)
