"""Description of a figure of merit: what tables and studies need to know of it, and how it is computed."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Self

from nsm.metrics.measurements import Measurements
from nsm.metrics.unit import Unit

#: Separates the name of a figure from the time at which it was taken: ``volume error t=0``.
AT = " t="


class Section(Enum):
    """Parts of a table of figures, in the order in which they are shown."""

    VOLUME = "volume over time"
    ENDS = "end shapes"
    EQUATIONS = "equations"
    ADVECTION = "advection by V"
    INTERIOR = "change of volume inside"
    MOTION = "motion"
    SURFACE = "surface"
    TOPOLOGY = "topology"
    EXACT_ENDS = "exact ends"


@dataclass(frozen=True)
class Metric(ABC):
    """A figure of merit of a morph.

    Each is a function in a module of `nsm.metrics.figures`, decorated with `define`. A new module there is all that a
    new figure takes.

    Args:
        name: Name in tables and in ``metrics.json``.
        unit: Unit of the values, which also sets the number of digits shown.
        section: Part of the table in which the figure is shown.
        compute: Computes the figure; its docstring defines it. None where the figure does not apply, such as one of V
            for a morph without velocity.
        ideal: Value of a perfect morph: the nearer a value, the better. None where no value is better than another.
        heading: Heading of the figure's column in a study's overview of a pair; None to leave it out there.
    """

    name: str
    unit: Unit
    section: Section
    compute: Callable[..., float | None]
    ideal: float | None = 0.0
    heading: str | None = None

    @classmethod
    def define(
        cls, name: str, unit: Unit, section: Section, ideal: float | None = 0.0, heading: str | None = None
    ) -> Callable[[Callable[..., float | None]], Self]:
        """Make a metric of the function below; the arguments are those of the class."""
        return lambda compute: cls(name, unit, section, compute, ideal, heading)

    @property
    def meaning(self) -> str:
        """Definition of the figure in one sentence, without a period."""
        return (inspect.getdoc(self.compute) or self.name).removesuffix(".")

    @abstractmethod
    def values(self, measured: Measurements) -> dict[str, float]:
        """Values by the name of their row; nan where one is not defined, nothing where it does not apply."""

    def rows(self, names: Iterable[str]) -> list[str]:
        """Those of some names of rows that are of this metric, each once, in order of time."""
        return sorted({name for name in names if name.split(AT)[0] == self.name}, key=_time)


class MorphMetric(Metric):
    """A figure that a morph has one of; its function takes the measurements."""

    def values(self, measured: Measurements) -> dict[str, float]:
        value = self.compute(measured)
        return {} if value is None else {self.name: float(value)}


class KeyMetric(Metric):
    """A figure that is taken at every key of a morph, such as t = 0 and 1; its function also takes that time."""

    def values(self, measured: Measurements) -> dict[str, float]:
        found = {f"{self.name}{AT}{key.time:g}": self.compute(measured, key.time) for key in measured.morph.keys}
        return {name: float(value) for name, value in found.items() if value is not None}


def _time(row: str) -> float:
    """Time at which the figure of a row was taken; 0 for one that belongs to no time."""
    return float(row.partition(AT)[2] or 0)
