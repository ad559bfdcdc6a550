"""Surfaces that divide the shell between two nested surfaces into layers of equal volume."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nsm.geometry.advection import Progress
from nsm.geometry.harmonic import HarmonicGradient
from nsm.types import SignedDistance, SimplexMesh

#: Runge-Kutta steps from the inner to the outer surface.
_STEPS = 32
#: Newton steps at the outer surface, and the greatest change of h in one of them.
_CORRECTIONS, _MOST = 3, 0.25
#: Least slope of h relative to the steepest one, below which a column counts as having no length.
_FLAT = 1e-6


class Columns:
    """Columns between two nested surfaces, and the points below which a given fraction of a column's volume lies.

    A column is a thin tube of lines along ∇h, where h is harmonic between the surfaces, 0 on the inner and 1 on the
    outer one (`nsm.geometry.harmonic`). Because div ∇h = 0, the flux of ∇h is the same through every cross section of a
    tube. A cross section that moves with velocity ∇h therefore sweeps equal volumes in equal times, and the point

        x(s) = φ_{sT}(x₀),   φ the flow of ∇h, T the time from x₀ on the inner surface to the outer one,

    has the fraction s of the volume of its column below it. The velocity V = T ∇h, T constant along each line, has no
    divergence and carries the inner surface to the outer one from s = 0 to 1: each surface on the way divides every
    column in the same ratio, as the equivolumetric principle of Bok demands of cortical layers, and hence the whole
    shell.

    Args:
        points: Points on the inner surface, shape (n, d).
        inner: Signed distance g₀ of the inner surface.
        outer: Signed distance g₁ of the outer surface, which encloses the inner one.
        bounds: Corners of a box that contains the outer surface, shape (2, d).
        resolution: Number of cells along the longest edge of the box.
        progress: Called with the number of finished steps and of all steps.

    Attributes:
        touching: Whether each point lies on the outer surface, or outside of it, so that its column has no length.

    References:
        Bok, Der Einfluß der in den Furchen und Windungen auftretenden Krümmungen der Großhirnrinde auf die
        Rindenarchitektur, Zeitschrift für die gesamte Neurologie und Psychiatrie 1929.
        https://doi.org/10.1007/BF02864437
        Waehnert et al., Anatomically motivated modeling of cortical laminae, NeuroImage 2014.
        https://doi.org/10.1016/j.neuroimage.2013.03.078
    """

    touching: Bool[Tensor, " n"]

    def __init__(
        self,
        points: Float[Tensor, "n d"],
        inner: SignedDistance,
        outer: SignedDistance,
        bounds: Float[Tensor, "2 d"],
        resolution: int,
        progress: Progress = lambda done, total: None,
    ) -> None:
        x = points.double()
        self.touching = outer(x) >= 0
        progress(0, _STEPS)
        self._gradient = HarmonicGradient(inner, outer, bounds, resolution)
        self._flat = _FLAT / float((bounds[1] - bounds[0]).max())
        places, moments = [x], [x.new_zeros(len(x))]
        for step in range(_STEPS):
            place, duration = self._advanced(places[-1], 1 / _STEPS)
            places.append(place)
            moments.append(moments[-1] + duration)
            progress(step + 1, _STEPS)
        end, total = places[-1], moments[-1]
        for _ in range(_CORRECTIONS):  # ∇h is normal to the outer surface there
            slope = self._slope(end)[1]
            rise = (-outer(end).to(x) * slope).clamp(-_MOST, _MOST)
            end, total = end + (rise / slope)[:, None] * self._direction(end), total + rise / slope**2
        self._places, self._moments, self._total = torch.stack(places), torch.stack(moments), total

    def at(self, fraction: float) -> Float[Tensor, "n d"]:
        """Points below which a fraction of the volume of each column lies, shape (n, d)."""
        moment = fraction * self._total
        row = (self._moments[1:-1] < moment).sum(0)
        which = torch.arange(len(row))
        start, end = self._moments[row, which], self._moments[row + 1, which]
        before, after = self._places[row, which], self._places[row + 1, which]
        length = (end - start)[:, None]
        u = ((moment - start) / (end - start))[:, None]
        slopes = self._gradient(before) * length, self._gradient(after) * length
        # cubic through both places with the velocity ∇h there
        inward = before * (1 + 2 * u) * (1 - u) ** 2 + after * u**2 * (3 - 2 * u)
        place = inward + slopes[0] * u * (1 - u) ** 2 - slopes[1] * u**2 * (1 - u)
        beyond = after + slopes[1] * (u - 1)  # past the last place, where h is a little below 1
        return torch.where(self.touching[:, None], self._places[0], torch.where(u > 1, beyond, place))

    def _advanced(self, x: Tensor, rise: float) -> tuple[Tensor, Tensor]:
        """Move points to where h is greater by ``rise`` (Runge-Kutta of order 4), and return the time it takes, too."""
        rates: list[tuple[Tensor, Tensor]] = []
        for share in (0.0, 0.5, 0.5, 1.0):
            at = x + share * rise * rates[-1][0] if rates else x
            gradient, slope = self._slope(at)
            rates.append((gradient / slope[:, None] ** 2, slope**-2))
        weights = (1 / 6, 1 / 3, 1 / 3, 1 / 6)
        moved = sum(weight * rate[0] for weight, rate in zip(weights, rates, strict=True))
        duration = sum(weight * rate[1] for weight, rate in zip(weights, rates, strict=True))
        return x + rise * moved, rise * torch.as_tensor(duration)

    def _slope(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """∇h (n, d) and its norm (n,), which is never 0."""
        gradient = self._gradient(x)
        return gradient, gradient.norm(dim=1).clamp(min=self._flat)

    def _direction(self, x: Tensor) -> Tensor:
        return torch.nn.functional.normalize(self._gradient(x), dim=1)


def equal_volume_surfaces(
    mesh: SimplexMesh,
    inner: SignedDistance,
    outer: SignedDistance,
    bounds: Float[Tensor, "2 d"],
    fractions: Sequence[float],
    resolution: int,
    progress: Progress = lambda done, total: None,
) -> list[SimplexMesh]:
    """Surfaces below which given fractions of the volume of the shell lie, also locally, in every column (`Columns`).

    They have the simplices of the inner surface, and corresponding vertices are those of one column.

    Args:
        mesh: The inner surface.
        inner: Signed distance to it.
        outer: Signed distance to the outer surface, which encloses the inner one.
        bounds: Corners of a box that contains the outer surface, shape (2, d).
        fractions: Fractions from 0, the inner surface itself, to 1, the outer one.
        resolution: Number of cells along the longest edge of the box.
        progress: Called with the number of finished steps and of all steps.

    Example:
        >>> import torch
        >>> from nsm.geometry.layers import equal_volume_surfaces
        >>> from nsm.shapes import Ball
        >>> inner, outer = Ball(1.0, [0.0, 0.0]), Ball(2.0, [0.0, 0.0])
        >>> (half,) = equal_volume_surfaces(inner.surface(), inner, outer, outer.exact_bounds(), [0.5], resolution=40)
        >>> round(float(half.vertices.norm(dim=1).mean()), 2)  # ((1² + 2²) / 2)^(1/2)
        1.58
    """
    columns = Columns(mesh.vertices, inner, outer, bounds, resolution, progress)
    return [SimplexMesh(columns.at(fraction), mesh.simplices) for fraction in fractions]
