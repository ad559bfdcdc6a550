"""When and where the surface of a morph changes its topology."""

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
from nsm.types import Morph, SimplexMesh

#: Intervals of time are halved until they are this short.
TIME_TOLERANCE = 2e-3
#: Curvature is gathered over this many cells: more than the neck that a merging leaves within `TIME_TOLERANCE`.
_REACH = 3.0


class TopologyEvent(NamedTuple):
    """A change of the surface between two times; components and genus as (before, after)."""

    times: tuple[float, float]
    components: tuple[int, int]
    genus: tuple[int, int]
    #: Where it happens, in the coordinates of the box; of several at once, the strongest.
    place: tuple[float, ...]


class _State(NamedTuple):
    time: float
    mesh: SimplexMesh
    components: int
    genus: int


def topology_events(
    morph: Morph, times: Sequence[float], meshes: Sequence[SimplexMesh], resolution: int = 96
) -> tuple[TopologyEvent, ...]:
    """Find the changes of components and genus between times, narrow each down by bisection, and locate it.

    What appears and is gone again between two of the times is not seen.

    Args:
        morph: the morph.
        times: increasing.
        meshes: its surface at each of them.
        resolution: cells along the box on which further surfaces are extracted; that of the meshes.
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
    """Where (d,) two surfaces that are almost the same differ in topology.

    By Gauss and Bonnet the curvature of the inside of a surface sums to its Euler number, which every merging, parting,
    appearing and vanishing changes by one; and elsewhere the curvature is nearly the same. So this is the place where
    the curvature within a few cells changes most.

    Args:
        before, after: the surfaces.
        bounds: corners (2, d) of the box.
        resolution: cells along its longest edge, of which the surfaces were extracted.
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
    # weights of both signs may leave the neighbourhood, where only several changes at once explain the sum
    near = np.linalg.norm(place - strongest) <= _REACH * cell
    return torch.as_tensor(place if near else strongest).to(bounds)


def _narrowed(before: _State, after: _State, look: Callable[[float], _State]) -> list[tuple[_State, _State]]:
    """The shortest intervals within one that hold a change, in order of time."""
    if (before.components, before.genus) == (after.components, after.genus):
        return []
    if after.time - before.time <= TIME_TOLERANCE:
        return [(before, after)]
    middle = look((before.time + after.time) / 2)
    return _narrowed(before, middle, look) + _narrowed(middle, after, look)


def _state(time: float, mesh: SimplexMesh) -> _State:
    return _State(time, mesh, topology.component_count(mesh), topology.genus(mesh))
