"""Surfaces that divide the shell between two nested surfaces into layers of equal volume."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from nsm.geometry.advection import Progress
from nsm.geometry.harmonic import HarmonicGradient
from nsm.types import SignedDistance, SimplexMesh

log = logging.getLogger(__name__)

#: Length of a Runge-Kutta step along a column, in cells.
_STEP = 0.25
#: Greatest length of a column, in edges of the box; longer ones are lost.
_LONGEST = 1.0
#: Newton steps at the outer surface.
_CORRECTIONS = 3
#: Slope of h times the edge of the box below which its direction is not known.
_FLAT = 1e-6


class _Segment(NamedTuple):
    """One step along the columns that have not ended before.

    Attributes:
        column: Numbers of the columns, shape (m,).
        places: Places before and after the step, shape (2, m, d).
        moments: Times of the flow of ∇h at both, shape (2, m).
        gradients: ∇h at both, shape (2, m, d).
    """

    column: Int[Tensor, " m"]
    places: Float[Tensor, "2 m d"]
    moments: Float[Tensor, "2 m"]
    gradients: Float[Tensor, "2 m d"]


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
        progress: Called with the number of finished columns and of all.

    Attributes:
        touching: Whether each point lies on the outer surface, or outside of it, so that its column has no length.
        lost: Whether a column does not reach the outer surface, because ∇h is 0 or the column is long.

    References:
        Bok, Der Einfluß der in den Furchen und Windungen auftretenden Krümmungen der Großhirnrinde auf die
        Rindenarchitektur, Zeitschrift für die gesamte Neurologie und Psychiatrie 1929.
        https://doi.org/10.1007/BF02864437
        Waehnert et al., Anatomically motivated modeling of cortical laminae, NeuroImage 2014.
        https://doi.org/10.1016/j.neuroimage.2013.03.078
    """

    touching: Bool[Tensor, " n"]
    lost: Bool[Tensor, " n"]

    def __init__(
        self,
        points: Float[Tensor, "n d"],
        inner: SignedDistance,
        outer: SignedDistance,
        bounds: Float[Tensor, "2 d"],
        resolution: int,
        progress: Progress = lambda done, total: None,
    ) -> None:
        self._start = points.double()
        self.touching = outer(self._start) >= 0
        progress(0, len(points))
        self._gradient = HarmonicGradient(inner, outer, bounds, resolution)
        edge = float((bounds[1] - bounds[0]).max())
        self._step, self._flat = _STEP * edge / resolution, _FLAT / edge
        self._segments: list[_Segment] = []
        self._total = self._start.new_zeros(len(points))
        column, x = torch.arange(len(points))[~self.touching], self._start[~self.touching]
        for _ in range(int(_LONGEST * edge / self._step)):
            known = self._gradient(x).norm(dim=1) > self._flat
            column, x = column[known], x[known]
            if not len(column):
                break
            after = self._advanced(x)
            ended = self._gradient.to_outer(after) >= 0
            after[ended] = self._onto(outer, after[ended])
            self._append(column, x, after)
            column, x = column[~ended], after[~ended]
            progress(len(points) - len(column), len(points))
        ends = torch.zeros_like(self.touching)
        for segment in self._segments:
            ends[segment.column] = outer(segment.places[1]).abs().to(self._start) < self._step
        self.lost = ~(ends | self.touching)

    def at(self, fraction: float) -> Float[Tensor, "n d"]:
        """Points below which a fraction of the volume of each column lies, shape (n, d)."""
        found = self._start.clone()
        for segment in self._segments:
            wanted = fraction * self._total[segment.column]
            here = wanted >= segment.moments[0]  # a later segment replaces it if that holds there, too
            duration = (segment.moments[1] - segment.moments[0]).clamp(min=1e-300)
            u = ((wanted - segment.moments[0]) / duration).clamp(0, 1)[:, None]
            before, after = segment.places
            # cubic through both places with the velocity ∇h there, which is bounded so that it does not overshoot
            most = 3 * (after - before).norm(dim=1)
            speeds = segment.gradients * duration[:, None]
            speeds = speeds * (most / speeds.norm(dim=2).clamp(min=1e-300)).clamp(max=1)[..., None]
            place = before * (1 + 2 * u) * (1 - u) ** 2 + after * u**2 * (3 - 2 * u)
            place = place + speeds[0] * u * (1 - u) ** 2 - speeds[1] * u**2 * (1 - u)
            found[segment.column[here]] = place[here]
        return found

    def _advanced(self, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Move points by one step along ∇h/‖∇h‖ (Runge-Kutta of order 4)."""
        first = self._direction(x)
        second = self._direction(x + self._step / 2 * first)
        third = self._direction(x + self._step / 2 * second)
        fourth = self._direction(x + self._step * third)
        return x + self._step / 6 * (first + 2 * second + 2 * third + fourth)

    def _onto(self, outer: SignedDistance, x: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Move points near the outer surface onto it along ∇h, which is normal to it there."""
        for _ in range(_CORRECTIONS):
            away = outer(x).to(x).clamp(-2 * self._step, 2 * self._step)
            x = x - away[:, None] * self._direction(x)
        return x

    def _append(self, column: Tensor, before: Tensor, after: Tensor) -> None:
        """Add a step; the time that it takes is ∫ dl / ‖∇h‖, by Simpson's rule."""
        gradients = torch.stack([self._gradient(before), self._gradient(after)])
        middle = self._gradient((before + after) / 2)
        slowness = [1 / g.norm(dim=1).clamp(min=self._flat) for g in (gradients[0], middle, gradients[1])]
        length = (after - before).norm(dim=1)
        start = self._total[column]
        end = start + length / 6 * (slowness[0] + 4 * slowness[1] + slowness[2])
        self._total[column] = end
        moments, places = torch.stack([start, end]), torch.stack([before, after])
        self._segments.append(_Segment(column, places, moments, gradients))

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
        progress: Called with the number of finished columns and of all.

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
    if columns.lost.any():
        message = "%.2g %% of the columns do not reach the outer surface; try a higher resolution"
        log.warning(message, 100 * float(columns.lost.double().mean()))
    return [SimplexMesh(columns.at(fraction), mesh.simplices) for fraction in fractions]
