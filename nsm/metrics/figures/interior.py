"""Change of volumes inside of the shape: the Jacobian determinant of the flow of V from t = 0 to 1."""

from __future__ import annotations

from nsm.geometry.jacobian import PERCENTILES
from nsm.metrics.measurements import Measurements
from nsm.metrics.metric import MorphMetric, Section
from nsm.metrics.unit import PER_MILLE, RELATIVE


@MorphMetric.define("folding", RELATIVE, Section.INTERIOR)
def folding(measured: Measurements) -> float | None:
    """Share of the inside of the source where the Jacobian determinant of the flow to t = 1 is not positive."""
    return None if measured.interior is None else measured.interior.folded


@MorphMetric.define("interior change mean", PER_MILLE, Section.INTERIOR)
def mean(measured: Measurements) -> float | None:
    """Mean change of small volumes inside of the source from t = 0 to 1, relative to the wanted one."""
    return None if measured.interior is None else 1000 * measured.interior.mean


@MorphMetric.define("interior change std", PER_MILLE, Section.INTERIOR)
def std(measured: Measurements) -> float | None:
    """Standard deviation of the change of small volumes inside of the source."""
    return None if measured.interior is None else 1000 * measured.interior.std


@MorphMetric.define("interior change max", PER_MILLE, Section.INTERIOR)
def maximum(measured: Measurements) -> float | None:
    """Greatest absolute change of small volumes inside of the source."""
    return None if measured.interior is None else 1000 * measured.interior.maximum


@MorphMetric.define("interior change 1 %", PER_MILLE, Section.INTERIOR)
def low(measured: Measurements) -> float | None:
    """First percentile of the change of small volumes inside of the source."""
    return None if measured.interior is None else 1000 * measured.interior.percentiles[0]


@MorphMetric.define("interior change 99 %", PER_MILLE, Section.INTERIOR)
def high(measured: Measurements) -> float | None:
    """99th percentile of the change of small volumes inside of the source."""
    return None if measured.interior is None else 1000 * measured.interior.percentiles[PERCENTILES.index(99.0)]
