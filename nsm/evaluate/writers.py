"""Files that an evaluation writes: all measurements, a table, and curves over time."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from pathlib import Path

import nsm
from nsm.cli.files import atomic_write
from nsm.evaluate.tables import markdown_table
from nsm.metrics import Evaluation, Protocol, all_metrics
from nsm.metrics.surface import SurfaceFigures
from nsm.plots.curves import Curves, plot_curves, plot_volume_curves


def write_evaluations(
    folder: Path, origins: Mapping[str, str], results: Mapping[str, Evaluation], protocol: Protocol
) -> list[Path]:
    """Write ``metrics.json``, ``table.md``, ``volume.csv``, ``volume.png``, and ``curves.png``.

    Args:
        folder: Folder of these files, made if it does not exist.
        origins: Origin of each morph, such as the path of its checkpoint, by the morph's name.
        results: Evaluation of each morph, by the same names.
        protocol: Protocol of the evaluations.

    Returns:
        The files.
    """
    metrics, table, volumes, plot, curves = (
        folder / name for name in ("metrics.json", "table.md", "volume.csv", "volume.png", "curves.png")
    )
    content = {
        "version": nsm.__version__,
        "protocol": protocol.describe(),
        "meanings": {
            metric.name: {"unit": metric.unit.name, "ideal": metric.ideal, "text": metric.meaning}
            for metric in all_metrics()
        },
        "morphs": {name: {"origin": origins[name], **result.to_dict()} for name, result in results.items()},
    }
    with atomic_write(metrics) as temporary:
        temporary.write_text(json.dumps(content, indent=2, allow_nan=False))
    with atomic_write(table) as temporary:
        temporary.write_text(markdown_table({name: result.figures() for name, result in results.items()}))
    _write_volumes(volumes, results)
    # relative to the wanted volume, so that a wanted growth does not show as a change
    plot_volume_curves(plot, {name: (r.volume.times, r.volume.deviations + 1) for name, r in results.items()})
    plot_curves(curves, _panels(results))
    return [metrics, table, volumes, plot, curves]


def _write_volumes(path: Path, results: Mapping[str, Evaluation]) -> None:
    with atomic_write(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["morph", "time", "volume", "error", "wanted", "deviation"])
        for name, result in results.items():
            curve = result.volume
            errors = curve.volumes * float("nan") if curve.errors is None else curve.errors
            columns = (curve.times, curve.volumes, errors, curve.wanted, curve.deviations)
            for row in zip(*(column.tolist() for column in columns), strict=True):
                writer.writerow([name, *(f"{number:.9g}" for number in row)])


def _panels(results: Mapping[str, Evaluation]) -> dict[str, Curves]:
    """Curves of the moving surface, by the label of their panel and the name of their morph."""
    panels: dict[str, Curves] = {
        label: {
            name: (result.times, [float(value(surface)) for surface in result.surfaces])
            for name, result in results.items()
        }
        for label, value in _SURFACE_PANELS.items()
    }
    checks = {name: result.advection for name, result in results.items() if result.advection is not None}
    panels["advected volume,\nchange in %"] = {
        name: (check.times, [100 * (volume - 1) for volume in check.volumes]) for name, check in checks.items()
    }
    return panels


#: Quantity that each panel shows at each time, by the label of the panel.
_SURFACE_PANELS: dict[str, Callable[[SurfaceFigures], float]] = {
    "area (length in 2D)": lambda surface: surface.area,
    "mean speed of surface": lambda surface: surface.speed,
    "roughness in °": lambda surface: surface.roughness,
    "mean ‖∇f‖ on surface": lambda surface: surface.gradient_norm,
    "level set residual": lambda surface: surface.level_set,
    "mean |div V| on surface": lambda surface: surface.divergence,
    "components": lambda surface: surface.components,
    "genus": lambda surface: surface.genus,
}
