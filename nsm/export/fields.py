"""Formats that hold f and V as values on a regular grid, one set of files for each time."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

import nsm
from nsm.cli.files import atomic_write
from nsm.cli.progress import Progress
from nsm.export.request import Format, Request, refuse_surface_settings
from nsm.geometry.grid import CHUNK, Lattice
from nsm.morphs.file_coordinates import FileCoordinates
from nsm.types import Morph

log = logging.getLogger(__name__)

#: File beside the grids that describes them.
RECORD = "fields.json"
#: Provenance of a shape from a scanner, and the endings of files whose coordinates are right, anterior, and superior.
_SCANNED, _RAS = "labels", (".nii", ".nii.gz", ".mgz", ".mgh")


class SampledField(NamedTuple):
    """f and V at the points of a lattice, at one time.

    Attributes:
        time: Time in [0, 1].
        lattice: The lattice, in the coordinates of the file.
        distance: Signed distance f in lengths of these coordinates, shape (*lattice.shape,).
        velocity: Velocity V in these lengths per unit of t, shape (*lattice.shape, d); None for a morph without one.
        space: Name of the coordinate system, such as ``right-anterior-superior``; None if it is not known.
        unit: Name of the unit of length, such as ``mm``; None if it is not known.
    """

    time: float
    lattice: Lattice
    distance: Float[Tensor, "*shape"]
    velocity: Float[Tensor, "*shape d"] | None
    space: str | None = None
    unit: str | None = None


#: Writes the files of one time, with that number, to a folder; returns their names.
WriteField = Callable[[Path, int, SampledField], list[str]]


class SampledFields(Format):
    """f and V at the corners of cells that divide the box of the morph, in single precision.

    The box is that of the requested coordinates: for those of a file, the axis-parallel box around the box of the
    morph, outside of which f goes on as a distance and V as its nearest value (`nsm.FileCoordinates`).

    Args:
        name: Name of the format.
        write: Writes the files of one time.
    """

    dims = (2, 3)
    resolution = 128

    def __init__(self, name: str, write: WriteField) -> None:
        self.name, self.write = name, write

    def export(self, request: Request) -> Path:
        refuse_surface_settings(request, self.name, "the fields on a grid")
        morph = in_coordinates(request.morph, request.coordinates)
        lattice = Lattice.corners(morph.bounds, request.resolution)
        space, unit = space_and_unit(request.morph, request.coordinates)
        files = []
        with Progress("sampling", len(request.times), unit="times") as progress:
            for number, time in enumerate(request.times):
                sampled = sample_fields(morph, time, lattice)._replace(space=space, unit=unit)
                files.append(self.write(request.output, number, sampled))
                progress.advance()
        record = {"nsm": nsm.__version__, "coordinates": request.coordinates, "unit": unit, "times": request.times}
        with atomic_write(request.output / RECORD) as temporary:
            temporary.write_text(json.dumps(record | {"files": files}, indent=1) + "\n")
        what, shape = "f and V" if morph.has_velocity else "f", " × ".join(map(str, lattice.shape))
        log.info("wrote %s on %s points at %d times to %s", what, shape, len(request.times), request.output)
        return request.output


def in_coordinates(morph: Morph, coordinates: str) -> Morph:
    """Return the morph in a coordinate system of `nsm.export.request.COORDINATES`."""
    return morph if coordinates == "morph" else FileCoordinates(morph, coordinates)


def space_and_unit(morph: Morph, coordinates: str) -> tuple[str | None, str | None]:
    """Return the names of a coordinate system and of its unit, as NRRD writes them; None where they are not known."""
    origin = morph.provenance.get(coordinates, {})
    if origin.get("kind") != _SCANNED:
        return None, None
    return ("right-anterior-superior" if str(origin.get("path")).lower().endswith(_RAS) else None), "mm"


@torch.no_grad()
def sample_fields(morph: Morph, time: float, lattice: Lattice) -> SampledField:
    """Evaluate f and V at the points of a lattice, in chunks.

    Args:
        morph: The morph.
        time: Time in [0, 1].
        lattice: Points, in the coordinates of the morph.

    Example:
        >>> from nsm.fields import ScalarSiren
        >>> from nsm.morphs.neural import NeuralMorph
        >>> from nsm.shapes import Ball
        >>> morph = NeuralMorph(ScalarSiren(4, 8, 1), None, Ball(0.4), Ball(0.5)).requires_grad_(False)
        >>> sampled = sample_fields(morph, 0.5, Lattice.corners(morph.bounds, 8))
        >>> sampled.distance.shape, sampled.velocity
        (torch.Size([9, 9, 9]), None)
    """
    distances, velocities = [], []
    for index in lattice.indices().split(CHUNK):
        x = lattice.points(index)
        distances.append(morph(x, time).float())
        if (velocity := morph.velocity(x, time)) is not None:
            velocities.append(velocity.float())
    distance = torch.cat(distances).view(lattice.shape)
    velocity = torch.cat(velocities).view(*lattice.shape, morph.dim) if velocities else None
    return SampledField(time, lattice, distance, velocity)
