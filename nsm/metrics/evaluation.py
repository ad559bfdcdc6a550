"""All quality figures of a morph, under one protocol."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
from rich.table import Table

from nsm.metrics.endpoint import EndpointErrors, endpoint_errors
from nsm.metrics.residuals import QUARTERS, SurfaceResiduals, surface_residuals
from nsm.metrics.topology import SurfaceTopology, surface_topology
from nsm.metrics.volume_curve import VolumeCurve, even_times, volume_curve
from nsm.types import Morph


class Evaluation(NamedTuple):
    """Everything measured on one morph."""

    volume: VolumeCurve
    ends: tuple[EndpointErrors, ...]
    residuals: tuple[SurfaceResiduals, ...]
    topology: tuple[SurfaceTopology, ...]
    #: Mean dihedral angle at t = ½ in degrees.
    roughness: float

    def figures(self) -> dict[str, float]:
        """The headline numbers by name, flat: what a table shows and what two runs are compared by."""
        named = {
            "volume std": self.volume.relative_std,
            "volume max": self.volume.maximum_deviation,
        }
        for end in self.ends:
            at = f" t={end.time:g}"
            named |= {
                "morph to shape" + at: end.morph_to_shape.mean,
                "morph to shape 99%" + at: end.morph_to_shape.percentile_99,
                "shape to morph" + at: end.shape_to_morph.mean,
                "chamfer" + at: end.chamfer,
                "hausdorff" + at: end.hausdorff,
                "normal error" + at: end.normal_error,
                "volume error" + at: end.volume_error,
            }
        named |= {f"gradient norm t={r.time:g}": r.gradient_norm for r in self.residuals}
        named |= {f"level set residual t={r.time:g}": r.level_set for r in self.residuals}
        named |= {
            "most components": max(s.components for s in self.topology),
            "fewest components": min(s.components for s in self.topology),
            "roughness t=0.5": self.roughness,
        }
        return named

    def to_dict(self) -> dict[str, Any]:
        """Everything, as JSON takes it: numbers that are not defined become None."""
        return _plain(
            {
                "figures": self.figures(),
                "volume": {
                    "times": self.volume.times.tolist(),
                    "volumes": self.volume.volumes.tolist(),
                    "relative_std": self.volume.relative_std,
                    "maximum_deviation": self.volume.maximum_deviation,
                },
                "ends": [
                    end._asdict()
                    | {"morph_to_shape": end.morph_to_shape._asdict(), "shape_to_morph": end.shape_to_morph._asdict()}
                    | {"chamfer": end.chamfer, "hausdorff": end.hausdorff}
                    for end in self.ends
                ],
                "residuals": [r._asdict() for r in self.residuals],
                "topology": [s._asdict() for s in self.topology],
                "roughness": self.roughness,
            }
        )


@torch.no_grad()
def evaluate_morph(
    morph: Morph,
    *,
    volume_resolution: int = 96,
    surface_resolution: int = 128,
    times: int = 11,
    progress: Callable[[str], None] = lambda stage: None,
) -> Evaluation:
    """Measure a morph: volume over time, both ends, ‖∇f‖ and residual on the moving surface, topology, roughness.

    Args:
        morph: the morph; its box ``morph.bounds`` is the unit of length and what grids are laid over.
        volume_resolution: cells along the box for volumes, topology, roughness and residuals.
        surface_resolution: cells along the box for the surfaces compared at both ends.
        times: how many times from 0 to 1, both included, volume and topology are looked at.
        progress: is told the name of each stage as it begins.
    """
    when = even_times(times)
    progress("volume over time")
    curve = volume_curve(morph, when, volume_resolution)
    ends = []
    for time, shape in ((0.0, morph.source), (1.0, morph.target)):
        progress(f"surface at t = {time:g}")
        ends.append(endpoint_errors(morph, time, shape, surface_resolution, volume_resolution))
    progress("gradient and residual on the surface")
    residuals = tuple(surface_residuals(morph, time, volume_resolution) for time in QUARTERS)
    progress("topology over time")
    counts = tuple(surface_topology(morph, time, volume_resolution) for time in when.tolist())
    halfway = next((s for s in counts if s.time == 0.5), None) or surface_topology(morph, 0.5, volume_resolution)
    return Evaluation(curve, tuple(ends), residuals, counts, halfway.roughness)


def table(runs: Mapping[str, Mapping[str, float | None]], title: str | None = None) -> Table:
    """A rich table of `Evaluation.figures`: one row a figure, one column a run.

    Args:
        runs: figures by run; runs may lack figures that others have.
        title: heading.
    """
    out = Table(title=title)
    out.add_column("figure", no_wrap=True)
    for name in runs:
        out.add_column(name, justify="right")
    rows = dict.fromkeys(key for figures in runs.values() for key in figures)
    for row in rows:
        cells = [_cell(row, figures.get(row)) for figures in runs.values()]
        if any(cells):
            out.add_row(row, *cells)
    return out


def _cell(name: str, value: float | None) -> str:
    if value is None or math.isnan(value):
        return ""
    if "components" in name:
        return f"{value:.0f}"
    if "normal" in name or "roughness" in name:
        return f"{value:.1f}°"
    return f"{value:.2f}" if "gradient" in name else f"{value:.4f}"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
