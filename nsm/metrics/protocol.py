"""Settings of a measurement, which two morphs must share for their figures to be compared."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from nsm.geometry.advection import DEFAULT_METHOD
from nsm.geometry.volume import VOLUME_RESOLUTION
from nsm.metrics import endpoint, events, residuals


@dataclass(frozen=True)
class Protocol:
    """Resolutions and times of a measurement.

    Args:
        volume_resolution: Cells along the box for volumes and for the surface over time.
        surface_resolution: Cells along the box for the surfaces that are compared at both ends.
        times: Number of times, evenly spaced from 0 to 1, at least 2.
        samples: Points on the surface, in the shell around it, and in the box over which figures are averaged; inside,
            a tenth as many.
        shell_width: |f| on the rim of the shell around the surface, in units of length.
    """

    volume_resolution: int = VOLUME_RESOLUTION
    surface_resolution: int = endpoint.SURFACE_RESOLUTION
    times: int = 11
    samples: int = residuals.SAMPLES
    shell_width: float = residuals.SHELL_WIDTH

    def describe(self) -> dict[str, Any]:
        """Return these settings and the constants of the measuring functions, for a file that explains itself."""
        return asdict(self) | {
            "points_on_end_surfaces": endpoint.SAMPLES,
            "points_to_find_one_in_shell": residuals.TRIES,
            "time_step_of_rates": residuals.TIME_STEP,
            "time_tolerance_of_events": events.TIME_TOLERANCE,
            "advection": repr(DEFAULT_METHOD),
        }


#: Protocol of `nsm.metrics.evaluate_morph` unless another is given.
DEFAULT_PROTOCOL = Protocol()
