"""Estimation and consistent orientation of normals of point clouds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

#: Number of neighbors to which the tangent plane of a point is fitted.
PLANE_NEIGHBORS = 12
#: Number of neighbors whose directions determine whether a point lies at a rim.
RIM_NEIGHBORS = 20
#: Angle in degrees of the tangent plane without neighbors from which a point counts as lying at a rim. In the interior
#: of a random cloud this happens to 1 of 600 points.
RIM_ANGLE = 140.0
#: Maximum distance of points at the rim of one hole, in radii of the neighborhoods, and minimum number of such points.
RIM_REACH, RIM_POINTS = 2.5, 12
#: Cosine between the normals of neighbors below which they contradict each other.
CONTRADICTION = -0.5


class Orientation(NamedTuple):
    """Normals of a cloud.

    Attributes:
        normals: Unit normals, outward where this could be determined, shape (n, 3).
        agreement: Fraction of neighbors whose normals do not point in opposite directions.
        pieces: Number of connected components of the graph of neighbors.
    """

    normals: np.ndarray
    agreement: float
    pieces: int


class Rims(NamedTuple):
    """The rims of a partial cloud.

    Attributes:
        points: Number of points on rims of holes.
        holes: Number of holes.
    """

    points: int
    holes: int


def estimate_normals(points: np.ndarray) -> Orientation:
    """Fit a tangent plane to the neighbors of each point, and orient the normals along a spanning tree.

    The normal is the direction of least variance among the neighbors (principal component analysis). Signs are
    propagated along the minimum spanning tree of the graph of neighbors with the weights 1 − |⟨n_i, n_j⟩|, from the
    highest point of each component, whose normal points up.

    Args:
        points: Distinct points, more than `PLANE_NEIGHBORS`, shape (n, 3).

    References:
        Hoppe et al., Surface Reconstruction from Unorganized Points, SIGGRAPH 1992.
        https://doi.org/10.1145/133994.134011
    """
    count = len(points)
    _, near = cKDTree(points).query(points, k=PLANE_NEIGHBORS + 1)
    spread = points[near] - points[near].mean(1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))
    normals = axes[:, :, 0]
    rows, columns = np.repeat(np.arange(count), PLANE_NEIGHBORS), near[:, 1:].ravel()
    cosines = np.einsum("ij,ij->i", normals[rows], normals[columns])
    # sparse graphs omit edges of weight zero
    weights = 1 - np.abs(cosines) + 1e-9
    graph = coo_array((weights, (rows, columns)), shape=(count, count)).tocsr()
    tree = minimum_spanning_tree(graph.maximum(graph.T))
    tree = tree + tree.T
    pieces, piece = connected_components(tree, directed=False)
    signs = np.ones(count)
    for number in range(pieces):
        members = np.flatnonzero(piece == number)
        highest = members[np.argmax(points[members, 2])]
        signs[highest] = np.copysign(1, normals[highest, 2])
        order, parents = breadth_first_order(tree, highest, directed=False)
        turns = np.copysign(1, np.einsum("ij,ij->i", normals[order[1:]], normals[parents[order[1:]]]))
        for child, turn in zip(order[1:], turns, strict=True):
            signs[child] = signs[parents[child]] * turn
    agreement = float((signs[rows] * signs[columns] * cosines > CONTRADICTION).mean())
    return Orientation(signs[:, None] * normals, agreement, int(pieces))


def find_rims(points: np.ndarray, normals: np.ndarray) -> Rims:
    """Count the points at rims, where a wide angle of the tangent plane contains no neighbors.

    Args:
        points: Distinct points, more than `RIM_NEIGHBORS`, shape (n, 3).
        normals: Unit normals, shape (n, 3).

    References:
        Bendels, Schnabel, and Klein, Detecting Holes in Point Set Surfaces, Journal of WSCG 14, 2006.
    """
    distances, near = cKDTree(points).query(points, k=RIM_NEIGHBORS + 1)
    offsets = points[near[:, 1:]] - points[:, None]
    aside = np.where(np.abs(normals[:, :1]) < 0.7, [1.0, 0, 0], [0, 1.0, 0])
    first = np.cross(normals, aside)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)
    angles = np.arctan2(np.einsum("nki,ni->nk", offsets, second), np.einsum("nki,ni->nk", offsets, first))
    angles.sort(axis=1)
    gaps = np.diff(np.concatenate([angles, angles[:, :1] + 2 * np.pi], 1), axis=1).max(1)
    rim = np.flatnonzero(gaps > np.deg2rad(RIM_ANGLE))
    if not len(rim):
        return Rims(0, 0)
    pairs = cKDTree(points[rim]).query_pairs(RIM_REACH * np.median(distances[:, -1]), output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(rim), len(rim)))
    sizes = np.bincount(connected_components(links, directed=False)[1])
    holes = sizes[sizes >= RIM_POINTS]
    return Rims(int(holes.sum()), len(holes))
