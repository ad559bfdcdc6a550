"""Growth through given volumes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from torch import Tensor

from nsm.cli.settings import increasing, invalid, positive
from nsm.morphs.growth.base import UNSCALED, Growth, Time


class Table(Growth):
    """Volume that passes through given values: piecewise cubic, smooth, and monotone between neighbors (PCHIP).

    Args:
        dim: Dimension d of space.
        times: Increasing times from 0 to 1; None for those of ``own``.
        volumes: Relative volume at each time, where None stands for that of ``own``; None for all of them.
        own: Relative volumes of the shapes, by their times, before they were scaled to one volume.

    Raises:
        InputError: If the times do not increase from 0 to 1, or there is not one positive volume for each, or one is
            missing where there is no shape.

    References:
        F. N. Fritsch and J. Butland, A method for constructing local monotone piecewise cubic interpolants,
        SIAM Journal on Scientific and Statistical Computing 5, 1984, https://doi.org/10.1137/0905021.

    Example:
        >>> Table(3, [0, 0.3, 1], [1.0, 1.4, 0.8]).extremes
        (0.8, 1.4)
    """

    def __init__(
        self,
        dim: int,
        times: Sequence[float] | None = None,
        volumes: Sequence[float | None] | None = None,
        own: Mapping[float, float] = UNSCALED,
    ) -> None:
        super().__init__(dim)
        knots = increasing("growth.times", sorted(own) if times is None else times, "[0,0.3,1]")
        if len(knots) < 2 or (knots[0], knots[-1]) != (0, 1):
            raise invalid("growth.times", "a list from 0 to 1", knots, "[0,0.3,1]")
        given = [None] * len(knots) if volumes is None else list(volumes)
        if len(given) != len(knots):
            example = ",".join("null" if knot in own else "1" for knot in knots)
            raise invalid("growth.volumes", f"{len(knots)} volumes, one for each time", given, f"[{example}]")
        filled = [own.get(knot) if value is None else value for knot, value in zip(knots, given, strict=True)]
        values = [positive("growth.volumes", value) for value in filled]
        curve = PchipInterpolator(knots, values)
        self._extremes = min(values), max(values)
        self._knots = torch.tensor(knots, dtype=torch.double)
        self._cubics = torch.from_numpy(curve.c.copy())
        self._slopes = torch.from_numpy(curve.derivative().c.copy())

    @property
    def extremes(self) -> tuple[float, float]:
        return self._extremes

    def relative_volume(self, t: Time) -> Time:
        return self._evaluate(self._cubics, t)

    def relative_rate(self, t: Time) -> Time:
        return self._evaluate(self._slopes, t)

    def _evaluate(self, coefficients: Float[Tensor, "order pieces"], t: Time) -> Time:
        """Evaluate the polynomial of the piece that holds each time by Horner's scheme, highest power first."""
        if not isinstance(t, Tensor):
            return float(self._evaluate(coefficients, torch.tensor(t, dtype=torch.double)))
        knots, coefficients = self._knots.to(t), coefficients.to(t)
        piece = torch.searchsorted(knots[1:-1], t.detach(), right=True)
        since = t - knots[piece]
        value = torch.zeros_like(t)
        for row in coefficients:
            value = value * since + row[piece]
        return value
