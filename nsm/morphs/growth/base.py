"""How a volume changes over time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import TypeVar

from torch import Tensor

from nsm.cli.settings import positive

#: One time, or n times of shape (n,); functions of it return the same kind.
Time = TypeVar("Time", float, Tensor)
#: Relative volumes of two shapes, by their times, that were not scaled to one volume.
UNSCALED: Mapping[float, float] = MappingProxyType({0.0: 1.0, 1.0: 1.0})


class Growth(ABC):
    """Relative volume of a morph from t = 0 to t = 1, where 1 is the constant volume at which the morph was made.

    Args:
        dim: Dimension d of space.
    """

    def __init__(self, dim: int) -> None:
        self.dim = dim

    @abstractmethod
    def relative_volume(self, t: Time) -> Time:
        """α(t)^d > 0 at one time, or at times of shape (n,)."""

    @abstractmethod
    def relative_rate(self, t: Time) -> Time:
        """Derivative of the relative volume, per unit of t."""

    @property
    @abstractmethod
    def extremes(self) -> tuple[float, float]:
        """Least and greatest relative volume from t = 0 to 1."""

    def scale(self, t: Time) -> Time:
        """α(t), the factor by which lengths are multiplied."""
        return self.relative_volume(t) ** (1 / self.dim)

    def rate(self, t: Time) -> Time:
        """α'(t), per unit of t."""
        return self.relative_rate(t) * self.relative_volume(t) ** (1 / self.dim - 1) / self.dim


class BetweenEnds(Growth):
    """Growth that two relative volumes v_0 and v_1 determine.

    Args:
        dim: Dimension d of space.
        source: Relative volume v_0 at t = 0, by default that of ``own``.
        target: Relative volume v_1 at t = 1, by default that of ``own``.
        own: Relative volumes of the shapes, by their times, before they were scaled to one volume.

    Raises:
        InputError: If a volume is not positive and finite.
    """

    def __init__(
        self,
        dim: int,
        source: float | None = None,
        target: float | None = None,
        own: Mapping[float, float] = UNSCALED,
    ) -> None:
        super().__init__(dim)
        self.source = positive("growth.source", own[0.0] if source is None else source)
        self.target = positive("growth.target", own[1.0] if target is None else target)

    @property
    def extremes(self) -> tuple[float, float]:
        return min(self.source, self.target), max(self.source, self.target)
