"""Description of a figure of merit: what tables and studies need to know of it, and how it is computed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from nsm.metrics.measurements import ENDS, Measurements
from nsm.metrics.unit import Unit

#: Separates the name of a figure from the time at which it was taken: ``volume error t=0``.
AT = " t="


class Section(Enum):
    """Parts of a table of figures, in the order in which they are shown."""

    VOLUME = "volume over time"
    ENDS = "end shapes"
    EQUATIONS = "equations"
    ADVECTION = "advection by V"
    MOTION = "motion"
    SURFACE = "surface"
    TOPOLOGY = "topology"
    EXACT_ENDS = "exact ends"


@dataclass(frozen=True, kw_only=True)
class Metric(ABC):
    """A figure of merit of a morph.

    Each is an attribute of a module in `nsm.metrics.figures`; a new module there is all that a new figure takes.

    Args:
        name: Name in tables and in ``metrics.json``.
        unit: Unit of the values, which also sets the number of digits shown.
        meaning: Definition in one sentence.
        section: Part of the table in which the figure is shown.
        ideal: Value of a perfect morph: the nearer a value, the better. None where no value is better than another.
        heading: Heading of the figure's column in a study's overview of a pair; None to leave it out there.
    """

    name: str
    unit: Unit
    meaning: str
    section: Section
    ideal: float | None = 0.0
    heading: str | None = None

    @abstractmethod
    def values(self, measured: Measurements) -> dict[str, float]:
        """Values by the name of their row; nan where one is not defined, nothing where it does not apply."""

    def names(self) -> tuple[str, ...]:
        """Names of the rows that this metric may fill, in order."""
        return (self.name,)


@dataclass(frozen=True, kw_only=True)
class MorphMetric(Metric):
    """A figure that a morph has one of.

    Args:
        compute: Computes the figure; None where it does not apply, such as one of V for a morph without velocity.
    """

    compute: Callable[[Measurements], float | None]

    def values(self, measured: Measurements) -> dict[str, float]:
        value = self.compute(measured)
        return {} if value is None else {self.name: float(value)}


@dataclass(frozen=True, kw_only=True)
class EndMetric(Metric):
    """A figure that is taken at t = 0 and at t = 1.

    Args:
        compute: Computes the figure at one of these times; None where it does not apply.
    """

    compute: Callable[[Measurements, float], float | None]

    def values(self, measured: Measurements) -> dict[str, float]:
        found = {name: self.compute(measured, time) for name, time in zip(self.names(), ENDS, strict=True)}
        return {name: float(value) for name, value in found.items() if value is not None}

    def names(self) -> tuple[str, ...]:
        return tuple(f"{self.name}{AT}{time:g}" for time in ENDS)
