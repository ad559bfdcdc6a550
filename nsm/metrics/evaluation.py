"""All figures of merit of a morph, measured under one protocol."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch

from nsm.geometry.flow import FlowError
from nsm.geometry.jacobian import PERCENTILES, VolumeChange
from nsm.metrics.advection import AdvectionCheck
from nsm.metrics.endpoint import EndpointErrors
from nsm.metrics.figures import all_metrics
from nsm.metrics.measurements import Measurements
from nsm.metrics.protocol import DEFAULT_PROTOCOL, Protocol
from nsm.types import Morph


class Evaluation(Measurements):
    """Measurements of a morph, and the figures of merit that follow from them."""

    def figures(self) -> dict[str, float]:
        """All figures by the name of their row, in the order of tables; `nsm.metrics.find_metric` defines each.

        A figure that is not defined is nan, and one that does not apply to the morph is absent.
        """
        return {name: value for metric in all_metrics() for name, value in metric.values(self).items()}

    def to_dict(self) -> dict[str, Any]:
        """Figures and measurements as JSON takes them: numbers that are not defined become None."""
        curve, motion = self.volume, self.motion
        factor = math.nan if self.file_volume is None else self.file_volume
        return _plain(
            {
                "figures": self.figures(),
                "volume": {
                    "times": curve.times.tolist(),
                    "volumes": curve.volumes.tolist(),
                    "volumes_in_file_units": (curve.volumes * factor).tolist(),
                    "errors": None if curve.errors is None else curve.errors.tolist(),
                    "wanted": curve.wanted.tolist(),
                    "deviations": curve.deviations.tolist(),
                    "beyond": self.volume_beyond,
                },
                "keys": [_key_dict(key) for key in self.keys],
                "surfaces": [surface._asdict() for surface in self.surfaces],
                "space": [{"shell": space.shell._asdict(), "box": space.box._asdict()} for space in self.space],
                "motion": {
                    "distance": motion.distance,
                    "unevenness": motion.unevenness,
                    "middle_share": motion.middle_share,
                },
                "events": [event._asdict() for event in self.events],
                "advection": None if self.advection is None else _advection_dict(self.advection),
                "interior": None if self.interior is None else _interior_dict(self.interior),
                "flow": None if self.flow is None else self.flow._asdict(),
            }
        )


@torch.no_grad()
def evaluate_morph(
    morph: Morph,
    protocol: Protocol = DEFAULT_PROTOCOL,
    progress: Callable[[str], object] = lambda stage: None,
    flow_error: Callable[[], FlowError] | None = None,
) -> Evaluation:
    """Measure a morph: volume, ends, the moving surface, both equations, topology, and advection by V.

    Args:
        morph: Morph to measure; its box ``morph.bounds`` is the unit of length and is covered by the grids.
        protocol: Resolutions and times.
        progress: Called with the name of each stage as it begins.
        flow_error: Measures the error of the flow maps that carry the detail of exact ends; None for other morphs.

    Returns:
        The measurements, whose `Evaluation.figures` are the rows of a table.

    Example:
        A disk that moves to the right by 0.2 and keeps its area.

        >>> class Moving(Morph):
        ...     dim, bounds, has_velocity = 2, torch.tensor([[-1.0, -1.0], [1.0, 1.0]]), True
        ...     def __init__(self):
        ...         self.source, self.target = (lambda x: self(x, 0.0)), (lambda x: self(x, 1.0))
        ...     def __call__(self, x, t):
        ...         return (x - self.velocity(x, t) * t).norm(dim=1) - 0.5
        ...     def gradient(self, x, t):
        ...         return torch.nn.functional.normalize(x - self.velocity(x, t) * t, dim=1)
        ...     def velocity(self, x, t):
        ...         return torch.tensor([0.2, 0.0]).expand_as(x)
        >>> figures = evaluate_morph(Moving(), Protocol(32, 32, times=3)).figures()
        >>> figures["volume max"] < 1e-3, figures["chamfer t=1"] < 1e-4, figures["most pieces"]
        (True, True, 1.0)
    """
    evaluation = Evaluation(morph, protocol, progress, flow_error)
    evaluation.figures()
    evaluation.free_meshes()
    return evaluation


def _key_dict(key: EndpointErrors) -> dict[str, Any]:
    return key._asdict() | {
        "morph_to_shape": key.morph_to_shape._asdict(),
        "shape_to_morph": key.shape_to_morph._asdict(),
        "chamfer": key.chamfer,
        "hausdorff": key.hausdorff,
    }


def _advection_dict(check: AdvectionCheck) -> dict[str, Any]:
    distances = [None if distance is None else distance._asdict() for distance in check.distances]
    return {"times": check.times, "volumes": check.volumes, "errors": check.errors, "distances": distances}


def _interior_dict(change: VolumeChange) -> dict[str, Any]:
    percentiles = {f"{percent:g}": value for percent, value in zip(PERCENTILES, change.percentiles, strict=True)}
    return change._asdict() | {"percentiles": percentiles}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
