"""All quality figures of a morph, under one protocol."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch

from nsm.geometry.advection import DEFAULT_METHOD
from nsm.geometry.flow import FlowError
from nsm.geometry.meshing import extract_surface, open_sides
from nsm.metrics import endpoint, events, residuals, surface
from nsm.metrics.advection import TransportCheck, check_transport
from nsm.metrics.endpoint import EndpointErrors, endpoint_errors
from nsm.metrics.events import TopologyEvent, topology_events
from nsm.metrics.figures import AT
from nsm.metrics.motion import Motion
from nsm.metrics.residuals import SHELL_WIDTH, SpaceResiduals, space_residuals
from nsm.metrics.surface import SurfaceFigures, surface_figures
from nsm.metrics.volume_curve import VolumeCurve, even_times, volume_beyond, volume_curve
from nsm.shapes import FieldShape
from nsm.types import Morph, SimplexMesh


@dataclass(frozen=True)
class Protocol:
    """What two morphs must have in common for their figures to be compared.

    Args:
        volume_resolution: cells along the box for volumes and for the surface over time.
        surface_resolution: cells along the box for the surfaces that are compared at both ends.
        times: how many times from 0 to 1, both included, at least two.
        shell_width: |f| on the rim of the shell around the surface, a length.
    """

    volume_resolution: int = 96
    surface_resolution: int = 128
    times: int = 11
    shell_width: float = SHELL_WIDTH

    def describe(self) -> dict[str, Any]:
        """These settings and all numbers that stand in the code, for a file that is to explain itself."""
        return asdict(self) | {
            "points_on_end_surfaces": endpoint.SAMPLES,
            "points_on_surface": surface.SAMPLES,
            "points_to_find_shell": residuals.SAMPLES,
            "points_in_shell_and_box": residuals.REGION_SAMPLES,
            "time_step_of_rates": residuals.TIME_STEP,
            "time_tolerance_of_events": events.TIME_TOLERANCE,
            "transport": repr(DEFAULT_METHOD),
        }


class Evaluation(NamedTuple):
    """Everything measured on one morph.

    Attributes:
        volume: over time.
        beyond: volume outside the box over that at t = 0, at the time when it is greatest; 0 where the surface keeps to
            the box.
        ends: how well it meets its two shapes.
        surfaces: of its surface at each time.
        space: residuals around the surface and in the box at each time.
        events: changes of topology, in order of time.
        transport: of the source by V; None for a method without velocity.
        flow: Error of the flow maps that make the ends exact; None for a morph without them.
        file_volume: volume of a unit cube of the box in the units of the source's file; not a number if it has none.
    """

    volume: VolumeCurve
    beyond: float
    ends: tuple[EndpointErrors, ...]
    surfaces: tuple[SurfaceFigures, ...]
    space: tuple[SpaceResiduals, ...]
    events: tuple[TopologyEvent, ...]
    transport: TransportCheck | None
    flow: FlowError | None = None
    file_volume: float = math.nan

    @property
    def motion(self) -> Motion:
        """Speed of the surface over time."""
        return Motion([s.time for s in self.surfaces], [s.speed for s in self.surfaces])

    def figures(self) -> dict[str, float]:
        """The headline numbers by name, flat: what a table shows; `nsm.metrics.figures` says what each is."""
        first, last = (self.volume.volumes[[0, -1]] * self.file_volume).tolist()
        known = {} if math.isnan(self.file_volume) else {f"volume{AT}0": first, f"volume{AT}1": last}
        named = known | {
            "volume std": self.volume.relative_std,
            "volume max": self.volume.maximum_deviation,
            "volume estimator error": self.volume.relative_error,
            "volume beyond": self.beyond,
        }
        for end in self.ends:
            named |= {f"{name}{AT}{end.time:g}": value for name, value in _end_figures(end).items()}
        named |= self._equation_figures() | self._transport_figures() | self._surface_figures()
        return named | ({} if self.flow is None else _flow_figures(self.flow))

    def to_dict(self) -> dict[str, Any]:
        """Everything, as JSON takes it: numbers that are not defined become None."""
        curve, motion = self.volume, self.motion
        ways = ("morph_to_shape", "shape_to_morph")
        return _plain(
            {
                "figures": self.figures(),
                "volume": {
                    "times": curve.times.tolist(),
                    "volumes": curve.volumes.tolist(),
                    "volumes_in_file_units": (curve.volumes * self.file_volume).tolist(),
                    "errors": None if curve.errors is None else curve.errors.tolist(),
                    "wanted": curve.wanted.tolist(),
                    "deviations": curve.deviations.tolist(),
                    "beyond": self.beyond,
                },
                "ends": [
                    end._asdict()
                    | {way: getattr(end, way)._asdict() for way in ways}
                    | {"chamfer": end.chamfer, "hausdorff": end.hausdorff}
                    for end in self.ends
                ],
                "surfaces": [s._asdict() for s in self.surfaces],
                "space": [{"shell": s.shell._asdict(), "box": s.box._asdict()} for s in self.space],
                "motion": {
                    "distance": motion.distance,
                    "unevenness": motion.unevenness,
                    "middle_share": motion.middle_share,
                },
                "events": [e._asdict() for e in self.events],
                "transport": None if self.transport is None else _transport_dict(self.transport),
                "flow": None if self.flow is None else self.flow._asdict(),
            }
        )

    def _ripples(self) -> float:
        """Roughness at the time next to 1/2 over the greater one of the two ends."""
        middle = min(self.surfaces, key=lambda surface: abs(surface.time - 0.5))
        ends = _greatest([self.surfaces[0].roughness, self.surfaces[-1].roughness])
        return middle.roughness / ends if ends > 0 else math.nan

    def _equation_figures(self) -> dict[str, float]:
        norms = [s.gradient_norm for s in self.surfaces]
        shells, boxes = zip(*self.space, strict=True)
        return {
            "gradient norm mean": _mean(norms),
            "gradient norm least": min(norms, key=_nan_last),
            "gradient norm greatest": _greatest(norms),
            "gradient norm std": _mean([s.gradient_norm_std for s in self.surfaces]),
            "eikonal shell": _mean([r.eikonal for r in shells]),
            "eikonal box": _mean([r.eikonal for r in boxes]),
            "level set surface": _mean([s.level_set for s in self.surfaces]),
            "level set shell": _mean([r.level_set for r in shells]),
            "level set box": _mean([r.level_set for r in boxes]),
            "divergence surface": _mean([s.divergence for s in self.surfaces]),
            "divergence shell": _mean([r.divergence for r in shells]),
            "divergence box": _mean([r.divergence for r in boxes]),
        }

    def _transport_figures(self) -> dict[str, float]:
        if self.transport is None:
            return {}
        return {
            "carried volume drift": self.transport.drift,
            "carried volume error": self.transport.error,
            "carried distance": self.transport.mean_distance,
            "carried distance max": self.transport.maximum_distance,
        }

    def _surface_figures(self) -> dict[str, float]:
        components, pieces = [s.components for s in self.surfaces], [s.pieces for s in self.surfaces]
        roughness = [s.roughness for s in self.surfaces]
        return {
            "distance moved": self.motion.distance,
            "speed max/mean": self.motion.unevenness,
            "motion in middle half": self.motion.middle_share,
            "area least": min(s.area for s in self.surfaces),
            "area greatest": max(s.area for s in self.surfaces),
            "roughness mean": _mean(roughness),
            "roughness greatest": _greatest(roughness),
            "roughness at 1/2": self._ripples(),
            "fewest components": min(components),
            "most components": max(components),
            "fewest pieces": min(pieces),
            "most pieces": max(pieces),
            "most handles": max(s.genus for s in self.surfaces),
            "topology events": len(self.events),
        }


@torch.no_grad()
def evaluate_morph(
    morph: Morph, protocol: Protocol = Protocol(), progress: Callable[[str], object] = lambda stage: None
) -> Evaluation:
    """Measure a morph: volume, ends, the moving surface, both equations, topology, and transport by V.

    Args:
        morph: the morph; its box ``morph.bounds`` is the unit of length and what grids are laid over.
        protocol: how finely.
        progress: is told the name of each stage as it begins.
    """
    times, resolution = even_times(protocol.times).tolist(), protocol.volume_resolution
    progress("volume over time")
    curve = volume_curve(morph, even_times(protocol.times), resolution)
    ends = []
    for time, shape in ((0.0, morph.source), (1.0, morph.target)):
        progress(f"surface at t = {time:g}")
        ends.append(endpoint_errors(morph, time, shape, protocol.surface_resolution, resolution))
    progress("surface over time")
    meshes = [extract_surface(partial(morph, t=time), morph.bounds, resolution) for time in times]
    beyond = _beyond(morph, times, meshes, curve, resolution)
    surfaces = tuple(surface_figures(morph, time, mesh) for time, mesh in zip(times, meshes, strict=True))
    progress("residuals in space")
    space = tuple(space_residuals(morph, time, protocol.shell_width) for time in times)
    progress("changes of topology")
    changes = topology_events(morph, times, meshes, resolution)
    progress("transport of the source")
    source = extract_surface(partial(morph, t=0.0), morph.bounds, resolution // _CARRIED_COARSER)
    carried = check_transport(morph, source, times, meshes)
    return Evaluation(curve, beyond, tuple(ends), surfaces, space, changes, carried, file_volume=_file_volume(morph))


def _file_volume(morph: Morph) -> float:
    """Volume of a unit cube of the box in the units of the source's file."""
    return morph.source.similarity.scale**-morph.dim if isinstance(morph.source, FieldShape) else math.nan


#: Stages that `evaluate_morph` tells of.
STAGES = 7
#: The surface that is carried has this many times larger cells; with the middles of its edges it has as many vertices.
_CARRIED_COARSER = 2


def _beyond(
    morph: Morph, times: Sequence[float], meshes: Sequence[SimplexMesh], curve: VolumeCurve, resolution: int
) -> float:
    """Greatest volume outside the box, relative to V(0), over the times at which the surface leaves the box."""
    found = [
        volume_beyond(partial(morph, t=time), morph.bounds, resolution)
        for time, mesh in zip(times, meshes, strict=True)
        if open_sides(mesh, morph.bounds)
    ]
    start = float(curve.volumes[0])
    return max(found, default=0.0) / start if start > 0 else math.nan


def _end_figures(end: EndpointErrors) -> dict[str, float]:
    return {
        "morph to shape": end.morph_to_shape.mean,
        "morph to shape 99%": end.morph_to_shape.percentile_99,
        "morph to shape max": end.morph_to_shape.maximum,
        "shape to morph": end.shape_to_morph.mean,
        "shape to morph 99%": end.shape_to_morph.percentile_99,
        "shape to morph max": end.shape_to_morph.maximum,
        "chamfer": end.chamfer,
        "hausdorff": end.hausdorff,
        "normal error": end.normal_error,
        "volume error": end.volume_error,
    }


def _flow_figures(error: FlowError) -> dict[str, float]:
    return {"flow map": error.mean, "flow map max": error.maximum, "carried detail": error.field}


def _transport_dict(check: TransportCheck) -> dict[str, Any]:
    distances = [None if d is None else d._asdict() for d in check.distances]
    return {"times": check.times, "volumes": check.volumes, "errors": check.errors, "distances": distances}


def _mean(values: list[float]) -> float:
    """Mean over the times at which a figure is defined."""
    defined = [value for value in values if not math.isnan(value)]
    return float(np.mean(defined)) if defined else math.nan


def _greatest(values: Sequence[float]) -> float:
    return -min([-value for value in values], key=_nan_last)


def _nan_last(value: float) -> float:
    return math.inf if math.isnan(value) else value


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
