"""Times and places at which the surface of a morph changes its topology."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from torch import Tensor

from nsm.geometry import topology
from nsm.geometry.meshing import extract_surface
from nsm.geometry.volume import VOLUME_RESOLUTION
from nsm.types import Morph, SimplexMesh

#: Length below which an interval of time is not bisected further.
TIME_TOLERANCE = 2e-3
#: Width of the Gaussian that gathers curvature, in cells: wider than the neck that a merging grows within
#: `TIME_TOLERANCE`.
_REACH = 3.0


class TopologyEvent(NamedTuple):
    """A change of topology between two times.

    Attributes:
        times: Times before and after.
        components: Number of components before and after.
        genus: Genus before and after, all components together.
        place: Position of the change in the coordinates of the box; of several at once, that of the strongest.
    """

    times: tuple[float, float]
    components: tuple[int, int]
    genus: tuple[int, int]
    place: tuple[float, ...]


class _State(NamedTuple):
    time: float
    mesh: SimplexMesh
    components: int
    genus: int


def topology_events(
    morph: Morph, times: Sequence[float], meshes: Sequence[SimplexMesh], resolution: int = VOLUME_RESOLUTION
) -> tuple[TopologyEvent, ...]:
    """Find the changes of components and genus between times, narrow each down by bisection, and locate it.

    A change that is undone between two of the times is not found.

    Args:
        morph: Morph to examine.
        times: Increasing times, k of them.
        meshes: Surface of the morph at each time.
        resolution: Cells along the box on which the meshes and further surfaces are extracted.

    Returns:
        The changes, in order of time.
    """

    def look(time: float) -> _State:
        return _state(time, extract_surface(partial(morph, t=time), morph.bounds, resolution))

    states = [_state(time, mesh) for time, mesh in zip(times, meshes, strict=True)]
    changes = [change for before, after in pairwise(states) for change in _narrowed(before, after, look)]
    return tuple(
        TopologyEvent(
            (before.time, after.time),
            (before.components, after.components),
            (before.genus, after.genus),
            tuple(change_of_topology(before.mesh, after.mesh, morph.bounds, resolution).tolist()),
        )
        for before, after in changes
    )


def change_of_topology(
    before: SimplexMesh, after: SimplexMesh, bounds: Float[Tensor, "2 d"], resolution: int
) -> Float[Tensor, " d"]:
    """Locate the difference in topology between two surfaces that are otherwise almost the same.

    By the Gauss-Bonnet theorem the curvature of the inside of a surface sums to its Euler number, which changes by one
    whenever parts merge, split, appear, or vanish; elsewhere the curvature stays nearly the same. The change is
    therefore at the place where the curvature within a few cells differs most.

    Args:
        before: Surface before the change.
        after: Surface after the change.
        bounds: Corners of the box, lowest first, shape (2, d).
        resolution: Cells along the longest edge of the box from which the surfaces were extracted.

    Returns:
        The place of the change, shape (d,).
    """
    vertices = torch.cat([before.vertices, after.vertices]).double().cpu().numpy()
    change = torch.cat([-topology.total_curvatures(before), topology.total_curvatures(after)]).double().cpu().numpy()
    low, high = bounds.double().cpu().numpy()
    cell = float((high - low).max()) / resolution
    bins = np.ceil((high - low) / cell).astype(int)
    gathered = np.histogramdd(vertices, bins, list(zip(low, high, strict=True)), weights=change)[0]
    gathered = np.abs(gaussian_filter(gathered, _REACH, mode="constant"))
    strongest = low + (np.array(np.unravel_index(gathered.argmax(), bins)) + 0.5) * (high - low) / bins
    weights = change * np.exp(-((vertices - strongest) ** 2).sum(1) / (2 * (_REACH * cell) ** 2))
    place = weights @ vertices / weights.sum() if weights.sum() else strongest
    # the mean is not near where several changes at once have weights of both signs
    near = np.linalg.norm(place - strongest) <= _REACH * cell
    return torch.as_tensor(place if near else strongest).to(bounds)


def _narrowed(before: _State, after: _State, look: Callable[[float], _State]) -> list[tuple[_State, _State]]:
    """Bisect an interval into the shortest ones that hold a change, in order of time."""
    if (before.components, before.genus) == (after.components, after.genus):
        return []
    if after.time - before.time <= TIME_TOLERANCE:
        return [(before, after)]
    middle = look((before.time + after.time) / 2)
    return _narrowed(before, middle, look) + _narrowed(middle, after, look)


def _state(time: float, mesh: SimplexMesh) -> _State:
    return _State(time, mesh, topology.component_count(mesh), topology.genus(mesh))
