"""Repair of meshes whose triangles do not bound a solid: repeated, turned, and needless triangles."""

from __future__ import annotations

import logging

import igl
import numpy as np
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from nsm.geometry.triangles import Triangles

log = logging.getLogger(__name__)

#: How far beside a triangle the winding number is looked at, in parts of the size of the mesh.
_HAIR = 1e-5
#: So many triangles of a patch are looked at.
_LOOKED_AT = 64
#: The mean of the winding numbers on both sides of a triangle is 1/2 where it bounds a solid. A patch on which it is
#: farther than this from 1/2 everywhere is a wall inside, a sheet outside, or a shell that is turned.
_OFF = 0.3
#: The area on one side of a patch prevails if it is larger than that on the other by this part of both.
_BALANCE = 0.2
#: Shells in so many layers, one inside the other, are turned one after the other.
_LAYERS = 8


def repaired(vertices: np.ndarray, faces: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Make a mesh bound a solid as far as its triangles allow.

    Triangles that repeat others are dropped. Patches, which are joined along edges with two triangles, are turned so
    that neighbors agree. Of several patches, those that are walls inside of a solid or sheets outside of it are
    dropped, and shells are turned that would take away where nothing is. Each step is reported in the log.

    Args:
        vertices: (v, 3), relative to the center of the mesh.
        faces: Triangles (m, 3) of distinct vertices.
        name: Name of the mesh in the log.

    Returns:
        Vertices and triangles; the same arrays if nothing was to be done.
    """
    kept = _distinct(faces, name)
    patch = _patches(kept)
    turned = _contradicting(vertices, kept, patch)
    if turned.any():
        log.warning("%d of %d triangles of %s contradict their neighbors and are turned", turned.sum(), len(kept), name)
        kept = _flipped(kept, turned)
    if patch.max() > 0:
        kept = _turned_shells(vertices, kept, patch, name)
        kept = _without_walls(vertices, kept, patch, name)
    if len(kept) == len(faces):
        return vertices, kept
    used, index = np.unique(kept, return_inverse=True)
    return vertices[used], index.reshape(-1, 3).astype(np.int64)


def _distinct(faces: np.ndarray, name: str) -> np.ndarray:
    """The triangles, each once, whichever way round it is repeated."""
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    if len(first) == len(faces):
        return faces
    log.warning("%d of %d triangles of %s repeat others and are left out", len(faces) - len(first), len(faces), name)
    return faces[np.sort(first)]


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Number of each edge (3m,), 1 or −1 for its direction (3m,), and how many triangles each edge has."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, number, count = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True, return_counts=True)
    return number.reshape(-1), np.where(ends[:, 0] < ends[:, 1], 1, -1), count


def _patches(faces: np.ndarray) -> np.ndarray:
    """Number of the patch (m,) of each triangle: patches are joined by edges that have two triangles."""
    number, _, count = _edges(faces)
    joined = np.flatnonzero(count[number] == 2)
    pairs = joined[np.argsort(number[joined], kind="stable")].reshape(-1, 2) % len(faces)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(faces),) * 2)
    return connected_components(graph, directed=False)[1]


def _contradicting(vertices: np.ndarray, faces: np.ndarray, patch: np.ndarray) -> np.ndarray:
    """Which triangles (m,) to turn so that neighbors in a patch run along their edge in opposite directions.

    A patch keeps the side of most of its area, and if none prevails it gets a positive volume.
    """
    number, direction, count = _edges(faces)
    clash = (np.abs(np.bincount(number, direction)) == 2) & (count == 2)
    if not clash.any():
        return np.zeros(len(faces), dtype=bool)
    mixed = np.zeros(patch.max() + 1, dtype=bool)
    mixed[patch[np.flatnonzero(clash[number]) % len(faces)]] = True
    chosen = np.flatnonzero(mixed[patch])
    turned = np.zeros(len(faces), dtype=bool)
    turned[chosen] = _parity(igl.bfs_orient(np.ascontiguousarray(faces[chosen]))[0]) != _parity(faces[chosen])
    a, b, c = vertices[faces].transpose(1, 0, 2)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    balance = np.bincount(patch, np.where(turned, -areas, areas)) / np.bincount(patch, areas)
    volumes = _volumes(vertices, _flipped(faces, turned), patch)
    wrong = mixed & np.where(np.abs(balance) > _BALANCE, balance < 0, volumes < 0)
    return turned ^ wrong[patch]


def _flipped(faces: np.ndarray, which: np.ndarray) -> np.ndarray:
    """The triangles (m, 3), some of them (m,) the other way round."""
    return np.where(which[:, None], faces[:, ::-1], faces)


def _parity(faces: np.ndarray) -> np.ndarray:
    """Whether the corners of triangles are an even permutation of their order."""
    a, b, c = faces.T
    return ((a < b).astype(int) + (b < c) + (c < a)) % 2 == 0


def _volumes(vertices: np.ndarray, faces: np.ndarray, patch: np.ndarray) -> np.ndarray:
    """Signed volume of each patch, closed to the center of its corners."""
    corners = vertices[faces]
    count = np.bincount(patch)[:, None]
    middles = np.stack([np.bincount(patch, axis) for axis in corners.mean(1).T], 1) / count
    a, b, c = (corners - middles[patch][:, None]).transpose(1, 0, 2)
    return np.bincount(patch, np.einsum("ij,ij->i", a, np.cross(b, c)) / 6)


def _sides(vertices: np.ndarray, faces: np.ndarray, patch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest mean of the winding numbers on both sides of triangles, for each patch."""
    order = np.random.default_rng(0).permutation(len(faces))
    order = order[np.argsort(patch[order], kind="stable")]
    rank = np.arange(len(faces)) - np.searchsorted(patch[order], patch[order])
    looked = order[rank < _LOOKED_AT]
    corners = torch.from_numpy(vertices[faces[looked]])
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    hair = _HAIR * float(np.ptp(vertices, axis=0).max()) * torch.nn.functional.normalize(normals, dim=1)
    mesh = Triangles(vertices, faces)
    mean = (mesh.winding_number(corners.mean(1) + hair) + mesh.winding_number(corners.mean(1) - hair)).numpy() / 2
    least, greatest = np.full(patch.max() + 1, np.inf), np.full(patch.max() + 1, -np.inf)
    np.minimum.at(least, patch[looked], mean)
    np.maximum.at(greatest, patch[looked], mean)
    return least, greatest


def _inside_out(least: np.ndarray, greatest: np.ndarray) -> bool:
    """Whether all patches bound a solid from the wrong side, so that the mesh is to be turned as a whole."""
    return bool(((least > -0.5 - _OFF) & (greatest < _OFF - 0.5)).all())


def _turned_shells(vertices: np.ndarray, faces: np.ndarray, patch: np.ndarray, name: str) -> np.ndarray:
    """Turn the closed shells that have −1 on their inner and 0 on their outer side."""
    number, _, count = _edges(faces)
    is_open = np.zeros(patch.max() + 1, dtype=bool)
    is_open[patch[np.flatnonzero(count[number] != 2) % len(faces)]] = True
    total = 0
    for _ in range(_LAYERS):
        least, greatest = _sides(vertices, faces, patch)
        wrong = ~is_open & (greatest < 0.5 - _OFF) & (_volumes(vertices, faces, patch) < 0)
        if not wrong.any() or _inside_out(least, greatest):
            break
        faces = _flipped(faces, wrong[patch])
        total += int(wrong.sum())
    if total:
        log.warning("%d of %d shells of %s are inside out and are turned", total, len(is_open), name)
    return faces


def _without_walls(vertices: np.ndarray, faces: np.ndarray, patch: np.ndarray, name: str) -> np.ndarray:
    """Leave out the patches that have a solid on both sides everywhere, or on none."""
    least, greatest = _sides(vertices, faces, patch)
    if _inside_out(least, greatest):
        return faces
    needless = (least > 0.5 + _OFF) | (greatest < 0.5 - _OFF)
    if not needless.any() or needless.all():
        return faces
    log.warning(
        "%d of %d patches of %s are walls inside of it or sheets outside, and are left out",
        *(int(needless.sum()), len(needless), name),
    )
    return faces[~needless[patch]]
