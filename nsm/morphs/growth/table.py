"""Growth through given volumes."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from torch import Tensor

from nsm.cli.settings import increasing, invalid, positive
from nsm.morphs.growth.base import Growth, Time


class Table(Growth):
    """Volume that passes through given values: piecewise cubic, smooth, and monotone between neighbors (PCHIP).

    Args:
        dim: Dimension d of space.
        times: Increasing times from 0 to 1.
        volumes: Relative volume at each time; None at the first or the last time stands for that of ``own``.
        own: Relative volumes of the two shapes before they were scaled to one volume.

    Raises:
        InputError: If the times do not increase from 0 to 1, or there is not one positive volume for each.

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
        times: Sequence[float] = (0.0, 1.0),
        volumes: Sequence[float | None] = (None, None),
        own: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        super().__init__(dim)
        knots = increasing("growth.times", times, "[0,0.3,1]")
        if len(knots) < 2 or (knots[0], knots[-1]) != (0, 1):
            raise invalid("growth.times", "a list from 0 to 1", knots, "[0,0.3,1]")
        if len(volumes) != len(knots):
            example = ",".join(["null", *["1"] * (len(knots) - 2), "null"])
            raise invalid("growth.volumes", f"{len(knots)} volumes, one for each time", volumes, f"[{example}]")
        filled = [own[0] if volumes[0] is None else volumes[0], *volumes[1:]]
        filled[-1] = own[1] if filled[-1] is None else filled[-1]
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
