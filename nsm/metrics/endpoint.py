"""Deviation of a morph from its two shapes at the ends: distances between surfaces, normals, volume."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from nsm.geometry.distance import DistanceSummary, closest_points
from nsm.geometry.meshing import extract_surface
from nsm.geometry.sampling import sample_mesh
from nsm.geometry.volume import VOLUME_RESOLUTION, volume
from nsm.shapes.gradient import shape_gradient
from nsm.types import Morph, SignedDistance

#: Points drawn on each surface.
SAMPLES = 20_000
#: Cells along the longest edge of the box on which both surfaces are extracted by default.
SURFACE_RESOLUTION = 128
#: Step of the differences that give the normals of a shape whose gradient is not known, relative to the longest edge of
#: the box: small against the features of a shape, large against the rounding of single precision.
_STEP = 5e-4


class EndpointErrors(NamedTuple):
    """Errors of a morph at one end, in the units of its box; nan where a surface does not exist.

    Attributes:
        time: Time of the end.
        morph_to_shape: Distances from points of the morph's surface to the shape's.
        shape_to_morph: Distances from points of the shape's surface to the morph's.
        normal_error: Mean angle in degrees between ∇f on the morph's surface and the shape's normal at the nearest
            point.
        volume_error: V_morph / V_shape − 1.
    """

    time: float
    morph_to_shape: DistanceSummary
    shape_to_morph: DistanceSummary
    normal_error: float
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
    morph: Morph,
    time: float,
    shape: SignedDistance,
    resolution: int = SURFACE_RESOLUTION,
    volume_resolution: int = VOLUME_RESOLUTION,
) -> EndpointErrors:
    """Compare the surface of a morph at one time with that of a shape.

    Distances are exact distances from points spread evenly over one surface to the simplices of the other. They are
    distances between surfaces, which no scaling of f changes.

    Args:
        morph: Morph to compare.
        time: Time at which to compare, usually 0 or 1.
        shape: Signed distance of the shape that the morph should be at that time.
        resolution: Cells along the longest edge of ``morph.bounds`` for the two surfaces.
        volume_resolution: Cells along that edge for the two volumes.

    Returns:
        Distances both ways, angle between normals, and relative error of the volume.

    Example:
        A disk that is 0.05 too small in radius.

        >>> class Disk(Morph):
        ...     dim, bounds = 2, torch.tensor([[-1.0, -1.0], [1.0, 1.0]])
        ...     def __call__(self, x, t):
        ...         return x.norm(dim=1) - 0.45
        ...     def gradient(self, x, t):
        ...         return x / x.norm(dim=1, keepdim=True)
        >>> errors = endpoint_errors(Disk(), 1.0, lambda x: x.norm(dim=1) - 0.5)
        >>> round(errors.chamfer, 3), round(errors.volume_error, 2)
        (0.05, -0.19)
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
    expected_normals = normalize(shape_gradient(shape, there.points, step), dim=1)
    return EndpointErrors(
        time,
        DistanceSummary.of(there.distances),
        DistanceSummary.of(back.distances),
        float(torch.rad2deg(angles(normals, expected_normals)).mean()),
        volume_error,
    )


def angles(a: Float[Tensor, "n d"], b: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """Angles between unit vectors in radians, shape (n,).

    2 atan2(‖a − b‖, ‖a + b‖), which is accurate at small angles too, where acos⟨a, b⟩ is not.

    References:
        W. Kahan, How futile are mindless assessments of roundoff in floating-point computation?, 2006, §12,
        https://people.eecs.berkeley.edu/~wkahan/Mindless.pdf.
    """
    return 2 * torch.atan2((a - b).norm(dim=1), (a + b).norm(dim=1))
