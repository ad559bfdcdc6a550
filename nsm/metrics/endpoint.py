"""How well a morph begins and ends at its two shapes: distances between surfaces, normals, volume."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from nsm.geometry.distance import DistanceSummary, closest_points, sample_mesh
from nsm.geometry.meshing import extract_surface
from nsm.geometry.volume import volume
from nsm.types import Morph, SignedDistance

#: Points drawn on each surface.
SAMPLES = 20_000
#: Step of the differences that give the normals of a shape, a share of the longest edge of the box: far below what a
#: shape shows, far above the rounding of single precision.
_STEP = 5e-4


class EndpointErrors(NamedTuple):
    """Errors of a morph at one end, in the units of its box; not a number where a surface does not exist."""

    time: float
    #: Distances from points of the morph's surface to the shape's, and the other way.
    morph_to_shape: DistanceSummary
    shape_to_morph: DistanceSummary
    #: Mean angle in degrees between ∇f on the morph's surface and the shape's normal at the nearest point.
    normal_error: float
    #: V_morph / V_shape - 1.
    volume_error: float

    @property
    def chamfer(self) -> float:
        """Mean of the two mean distances."""
        return (self.morph_to_shape.mean + self.shape_to_morph.mean) / 2

    @property
    def hausdorff(self) -> float:
        """Greatest distance from a point of either surface to the other."""
        return max(self.morph_to_shape.maximum, self.shape_to_morph.maximum)


def endpoint_errors(
    morph: Morph, time: float, shape: SignedDistance, resolution: int = 128, volume_resolution: int = 96
) -> EndpointErrors:
    """Compare the surface of a morph at ``time`` with that of a shape.

    Both are extracted on ``resolution``^d cells of ``morph.bounds``. Distances are exact ones from points spread evenly
    over one surface to the simplices of the other; so they are the distance of surfaces, which no scaling of f changes.

    Args:
        morph: the morph.
        time: when to look, usually 0 or 1.
        shape: signed distance of the shape it should be then.
        resolution: of the two surfaces.
        volume_resolution: of the two volumes.
    """
    field = partial(morph, t=time)
    ours, theirs = (extract_surface(f, morph.bounds, resolution) for f in (field, shape))
    expected = volume(shape, morph.bounds, volume_resolution)
    volume_error = volume(field, morph.bounds, volume_resolution) / expected - 1 if expected > 0 else math.nan
    if not len(ours.simplices) or not len(theirs.simplices):
        unknown = DistanceSummary(math.nan, math.nan, math.nan)
        return EndpointErrors(time, unknown, unknown, math.nan, volume_error)

    generator = torch.Generator(morph.bounds.device).manual_seed(0)
    points = sample_mesh(ours, SAMPLES, generator).points
    there = closest_points(points, theirs)
    back = closest_points(sample_mesh(theirs, SAMPLES, generator).points, ours)
    normals = normalize(morph.gradient(points, time).detach(), dim=1)
    step = _STEP * float((morph.bounds[1] - morph.bounds[0]).max())
    expected_normals = normalize(finite_gradient(shape, there.points, step), dim=1)
    return EndpointErrors(
        time,
        DistanceSummary.of(there.distances),
        DistanceSummary.of(back.distances),
        float(torch.rad2deg(angles(normals, expected_normals)).mean()),
        volume_error,
    )


def finite_gradient(field: SignedDistance, points: Float[Tensor, "n d"], step: float) -> Float[Tensor, "n d"]:
    """Central differences (n, d), for fields that do not know their gradient."""
    with torch.no_grad():
        shifts = step * torch.eye(points.shape[1], dtype=points.dtype, device=points.device)
        return torch.stack([field(points + s) - field(points - s) for s in shifts], 1) / (2 * step)


def angles(a: Float[Tensor, "n d"], b: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """Angles (n,) in radians between unit vectors; exact for small ones too, where acos is not."""
    return 2 * torch.atan2((a - b).norm(dim=1), (a + b).norm(dim=1))
