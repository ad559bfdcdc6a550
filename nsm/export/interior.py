"""Interior correspondences: points inside of the source, where V carries them, and how it changes their volume."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np

import nsm
from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.cli.progress import Progress
from nsm.export.request import Format, Request, refuse_surface_settings
from nsm.export.surfaces import similarity_to
from nsm.geometry.jacobian import PERCENTILES, VolumeChange, trace_points
from nsm.metrics.interior import interior_points, jacobian_step
from nsm.morphs.advected import velocity_of
from nsm.morphs.file_coordinates import ENDS

log = logging.getLogger(__name__)

#: Names of both files, without their endings.
NAME = "interior"


class InteriorPoints(Format):
    """``interior.npz`` with the points and their determinants, and ``interior.json`` with a report of these.

    The points are the centers of cells inside of the source. The NPZ file holds ``times`` (k,), ``positions``
    (k, n, d) in the requested coordinates, and ``determinants`` (k, n), which are those of the flow from t = 0; and
    ``source_in_file`` and ``target_in_file`` (n, d), the points at t = 0 and t = 1, each in the coordinates of its own
    file. The report gives for each time the folded share and the change of volume, in per mille of the wanted volume.
    """

    dims = (2, 3)
    resolution = 32

    def export(self, request: Request) -> Path:
        refuse_surface_settings(request, NAME, "points of the inside")
        morph = request.morph
        velocity, points = velocity_of(morph), interior_points(morph, request.resolution)
        if not len(points):
            raise InputError(
                f"`resolution` must be high enough to show the inside of the source, got {request.resolution}. Try "
                f"`resolution={2 * request.resolution}`, or another morph."
            )
        times = [0.0, *request.times, 1.0]
        with Progress("tracing the inside") as progress:
            traced = trace_points(velocity, points, times, jacobian_step(morph), progress=progress.update)
        asked = similarity_to(morph, request.coordinates)
        ends = zip(ENDS, (traced.positions[0], traced.positions[-1]), strict=True)
        arrays: dict[str, Any] = {
            "times": np.array(request.times),
            "positions": np.stack([asked.apply(x).cpu().numpy() for x in traced.positions[1:-1]]),
            "determinants": traced.determinants[1:-1].cpu().numpy(),
            **{f"{end}_in_file": similarity_to(morph, end).apply(x).cpu().numpy() for end, x in ends},
        }
        with atomic_write(request.output / f"{NAME}.npz") as temporary:
            np.savez_compressed(temporary, **arrays)
        first = morph.wanted_volume(0.0)
        changes = [
            VolumeChange.of(row, morph.wanted_volume(time) / first)
            for time, row in zip(times, traced.determinants, strict=True)
        ]
        reports = [report(time, change) for time, change in zip(request.times, changes[1:-1], strict=True)]
        record = {"nsm": nsm.__version__, "coordinates": request.coordinates, "points": len(points), "times": reports}
        with atomic_write(request.output / f"{NAME}.json") as temporary:
            temporary.write_text(json.dumps(record, indent=1) + "\n")
        log.info("%s", in_words(changes[-1]))
        log.info("wrote %d points at %d times to %s", len(points), len(request.times), request.output)
        return request.output


def report(time: float, change: VolumeChange) -> dict[str, object]:
    """Describe the change of volume from t = 0 to a time, in per mille."""
    percentiles = {f"{percent:g}": 1000 * value for percent, value in zip(PERCENTILES, change.percentiles, strict=True)}
    return {
        "time": time,
        "folded_share": change.folded,
        "change_in_per_mille": {
            "mean": 1000 * change.mean,
            "std": 1000 * change.std,
            "maximum": 1000 * change.maximum,
            "percentiles": percentiles,
        },
    }


def in_words(change: VolumeChange) -> str:
    """Say how volumes inside change from t = 0 to 1.

    >>> in_words(VolumeChange(0.0, 0.001, 0.02, 0.08, (-0.04, -0.03, 0.0, 0.03, 0.05)))
    'inside from t = 0 to 1: 0 % folded, change of volume 1 ‰ ± 20 ‰ (1 % below -40 ‰, 1 % above 50 ‰, greatest 80 ‰)'
    """
    mean, std, low, high, greatest = (
        f"{1000 * value:.3g} ‰"
        for value in (change.mean, change.std, change.percentiles[0], change.percentiles[-1], change.maximum)
    )
    return (
        f"inside from t = 0 to 1: {100 * change.folded:.3g} % folded, change of volume {mean} ± {std} "
        f"(1 % below {low}, 1 % above {high}, greatest {greatest})"
    )
