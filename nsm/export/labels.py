"""Volumes of labels, carried along V and written like the given file."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import numpy as np

import nsm
from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.cli.progress import Progress
from nsm.export.request import Format, Request, refuse_surface_settings
from nsm.io.label_files import labels_suffix, write_labels_like
from nsm.morphs.carried_labels import FLOW_RESOLUTION, CarriedLabels
from nsm.morphs.file_coordinates import ENDS
from nsm.shapes.download import file_sha256, resolve
from nsm.shapes.labels import known_labels
from nsm.shapes.volume_files import read_voxels

log = logging.getLogger(__name__)

#: File beside the volumes with the volume of each label.
RECORD = "labels.json"


class LabelVolumes(Format):
    """Volumes ``labels_0000.nii.gz``, …, on the grid and in the format of the given one, and ``labels.json``.

    The given labels are those at t = 0, in the coordinates of the source's file, or with ``coordinates=target`` those
    at t = 1, in the coordinates of the target's. `nsm.morphs.carried_labels.CarriedLabels` carries them.
    """

    carries_labels = True
    resolution = FLOW_RESOLUTION
    coordinates = "source"

    def export(self, request: Request) -> Path:
        refuse_surface_settings(request, "labels", "volumes of labels")
        if request.labels is None:
            raise InputError(
                "`labels` must be a volume of labels for `format=labels`, got nothing. Try `labels=brain.nii.gz`."
            )
        if request.coordinates not in ENDS:
            raise InputError(
                f"`coordinates` must be source or target for `format=labels`, whose volume lies in the file of an end, "
                f"got {request.coordinates}. Try `coordinates=source`."
            )
        file = resolve(request.labels)
        voxels = read_voxels(file)
        known = known_labels(voxels.values, request.labels)
        carried = CarriedLabels(request.morph, voxels, request.coordinates, request.resolution)
        if outside := carried.outside():
            log.warning(
                "%.2g %% of the labeled voxels lie outside of the box of the morph, where V is not known; they move as "
                "the nearest point of the box",
                100 * outside,
            )
        names, counts, suffix = [], [_counts(voxels.values, known)], labels_suffix(file)
        with Progress("carrying labels", len(request.times), unit="times") as progress:
            for number, time in enumerate(request.times):
                values = carried.at(time)
                names.append(f"labels_{number:04d}{suffix}")
                write_labels_like(request.output / names[-1], file, values)
                counts.append(_counts(values, known))
                progress.advance()
        size = abs(float(np.linalg.det(voxels.affine[:3, :3])))
        volumes = {label: [size * count for count in column] for label, *column in zip(known, *counts, strict=True)}
        record = {
            "nsm": nsm.__version__,
            "labels": {"path": request.labels, "sha256": file_sha256(file), "end": request.coordinates},
            "times": request.times,
            "files": names,
            "volumes": {str(label): {"given": given, "at_times": later} for label, (given, *later) in volumes.items()},
        }
        with atomic_write(request.output / RECORD) as temporary:
            temporary.write_text(json.dumps(record, indent=1) + "\n")
        furthest = max(request.times, key=lambda time: abs(time - carried.start))
        log.info("the flow of V is accurate to %.2g voxels", carried.flow_error(furthest))
        log.info("wrote %d volumes to %s; volumes of the labels are in %s", len(names), request.output, RECORD)
        return request.output


def _counts(values: np.ndarray, labels: list[int]) -> list[int]:
    """Number of voxels of each label."""
    return [int((values == label).sum()) for label in labels]
