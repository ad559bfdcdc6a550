"""Change of volumes inside of the shape under the flow of V."""

from __future__ import annotations

from functools import partial
from typing import cast

from jaxtyping import Float
from torch import Tensor

from nsm.geometry.advection import RungeKutta, VelocityField
from nsm.geometry.grid import Lattice, evaluate
from nsm.geometry.jacobian import VolumeChange, trace_points
from nsm.types import DIVERGENCE_STEP, Morph

#: Number of points, at most, by default, and cells along the box on which they are chosen.
SAMPLES, _RESOLUTION = 1000, 48
#: Integrator of V; each point is advected with two neighbors for each axis.
_METHOD = RungeKutta(16)


def interior_change(morph: Morph, samples: int = SAMPLES) -> VolumeChange | None:
    """Measure the change of volumes inside of the source under the flow from t = 0 to 1, relative to the wanted one.

    V preserves the volume of the whole shape if its divergence vanishes on the moving surface. Inside, it may expand
    one part and compress another, which the distribution of det Dφ shows (`nsm.geometry.jacobian`).

    Args:
        morph: Morph to measure.
        samples: Number of points, at most.

    Returns:
        The distribution; None for a morph without velocity, or without an inside at t = 0.
    """
    points = interior_points(morph, _RESOLUTION)
    if not morph.has_velocity or not len(points):
        return None
    some = points[:: -(-len(points) // samples)]
    traced = trace_points(cast(VelocityField, morph.velocity), some, [0.0, 1.0], jacobian_step(morph), _METHOD)
    return VolumeChange.of(traced.determinants[-1], morph.wanted_volume(1.0) / morph.wanted_volume(0.0))


def interior_points(morph: Morph, resolution: int) -> Float[Tensor, "n d"]:
    """List the centers of cells, of which there are ``resolution`` along the box, inside of the morph at t = 0."""
    lattice = Lattice.centers(morph.bounds, resolution)
    points = lattice.points(lattice.indices())
    return points[evaluate(partial(morph, t=0.0), points) < 0]


def jacobian_step(morph: Morph) -> float:
    """Distance of the points whose advection gives Jacobians of the flow, a length."""
    return DIVERGENCE_STEP * float((morph.bounds[1] - morph.bounds[0]).max())
