"""Growth through given volumes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from nsm.cli.settings import increasing, invalid, positive
from nsm.geometry.monotone import MonotoneCubic
from nsm.morphs.growth.base import UNSCALED, Growth, Time


class Table(Growth):
    """Volume that passes through given values, smooth and monotone between neighbors (`MonotoneCubic`).

    Args:
        dim: Dimension d of space.
        times: Increasing times from 0 to 1; None for those of ``own``.
        volumes: Relative volume at each time, where None stands for that of ``own``; None for all of them.
        own: Relative volumes of the shapes, by their times, before they were scaled to one volume.

    Raises:
        InputError: If the times do not increase from 0 to 1, or there is not one positive volume for each, or one is
            missing where there is no shape.

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
        self._curve = MonotoneCubic(knots, values)
        self._extremes = min(values), max(values)

    @property
    def extremes(self) -> tuple[float, float]:
        return self._extremes

    def relative_volume(self, t: Time) -> Time:
        return self._curve(t) if isinstance(t, Tensor) else float(self._curve(torch.tensor(t, dtype=torch.double)))

    def relative_rate(self, t: Time) -> Time:
        if isinstance(t, Tensor):
            return self._curve.derivative(t)
        return float(self._curve.derivative(torch.tensor(t, dtype=torch.double)))
