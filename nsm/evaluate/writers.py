"""What was measured on morphs, as files: all of it, the table, and the curves over time."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path

import nsm
from nsm.cli.files import whole_file
from nsm.metrics import MEANINGS, Evaluation, Protocol, markdown_table
from nsm.plots.curves import Curves, plot_curves, plot_volume_curves


def write_evaluations(
    folder: Path, origins: Mapping[str, str], results: Mapping[str, Evaluation], protocol: Protocol
) -> list[Path]:
    """Write ``metrics.json``, ``table.md``, ``volume.csv``, ``volume.png`` and ``curves.png``.

    Args:
        folder: where they go; made if it is not there.
        origins: where each morph came from, by its name.
        results: by the same names.
        protocol: how they were measured.

    Returns:
        The files.
    """
    metrics, figures, rows, plot, curves = (
        folder / name for name in ("metrics.json", "table.md", "volume.csv", "volume.png", "curves.png")
    )
    told = {
        "version": nsm.__version__,
        "protocol": protocol.describe(),
        "meanings": {name: meaning._asdict() for name, meaning in MEANINGS.items()},
        "morphs": {name: {"origin": origins[name], **result.to_dict()} for name, result in results.items()},
    }
    with whole_file(metrics) as temporary:
        temporary.write_text(json.dumps(told, indent=2, allow_nan=False))
    with whole_file(figures) as temporary:
        temporary.write_text(markdown_table({name: result.figures() for name, result in results.items()}))
    _write_volumes(rows, results)
    # over the wanted volume, so that a growth that was asked for is no change
    plot_volume_curves(plot, {name: (r.volume.times, r.volume.deviations + 1) for name, r in results.items()})
    plot_curves(curves, _panels(results))
    return [metrics, figures, rows, plot, curves]


def _write_volumes(path: Path, results: Mapping[str, Evaluation]) -> None:
    with whole_file(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["morph", "time", "volume", "error", "wanted", "deviation"])
        for name, result in results.items():
            curve = result.volume
            errors = curve.volumes * float("nan") if curve.errors is None else curve.errors
            columns = (curve.times, curve.volumes, errors, curve.wanted, curve.deviations)
            for row in zip(*(column.tolist() for column in columns), strict=True):
                writer.writerow([name, *(f"{number:.9g}" for number in row)])


def _panels(results: Mapping[str, Evaluation]) -> dict[str, Curves]:
    """What `plot_curves` draws: figures of the moving surface by name of the morph."""
    chosen = {
        "area (length in 2D)": "area",
        "mean speed of surface": "speed",
        "roughness in °": "roughness",
        "mean ‖∇f‖ on surface": "gradient_norm",
        "level set residual": "level_set",
        "mean |div V| on surface": "divergence",
        "components": "components",
        "genus": "genus",
    }
    panels: dict[str, Curves] = {
        label: {
            name: ([s.time for s in result.surfaces], [float(getattr(s, field)) for s in result.surfaces])
            for name, result in results.items()
        }
        for label, field in chosen.items()
    }
    checks = {name: result.transport for name, result in results.items() if result.transport is not None}
    panels["carried volume,\nchange in %"] = {
        name: (check.times, [100 * (volume - 1) for volume in check.volumes]) for name, check in checks.items()
    }
    return panels
