"""Figures of merit, one file each.

Every `Metric` that is an attribute of a module of this folder is measured, written, and shown in tables.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from nsm.metrics.metric import AT, Metric, Section


def all_metrics() -> tuple[Metric, ...]:
    """All figures of merit, ordered by section, then by the name of their file, then as they stand in it."""
    modules = [import_module(f"{__name__}.{name}") for name in sorted(module.name for module in iter_modules(__path__))]
    found = [value for module in modules for value in vars(module).values() if isinstance(value, Metric)]
    sections = list(Section)
    return tuple(sorted(found, key=lambda metric: sections.index(metric.section)))


def find_metric(figure: str) -> Metric:
    """The metric of a row of a table.

    >>> find_metric("volume error t=1").meaning
    'Volume of the morph over that of the shape, minus 1'

    Args:
        figure: Name of the row, with or without the time at which it was taken.

    Raises:
        KeyError: If no metric has this name.
    """
    return {metric.name: metric for metric in all_metrics()}[figure.split(AT)[0]]
