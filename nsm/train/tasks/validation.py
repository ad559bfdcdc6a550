"""Validation of a morph in training, from its extracted surface."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from functools import cached_property, partial
from itertools import pairwise
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.geometry.band import sample_band
from nsm.geometry.grid import Lattice, evaluate
from nsm.geometry.meshing import open_sides, surface_in_band
from nsm.geometry.sampling import sample_mesh
from nsm.geometry.volume import volume, volume_in_surface
from nsm.metrics import VolumeCurve, times_through, volume_beyond
from nsm.metrics.pieces import Leftover, Pieces
from nsm.morphs.neural import NeuralMorph
from nsm.shapes import FieldShape
from nsm.types import SignedDistance, SimplexMesh

log = logging.getLogger(__name__)

#: Relative error of the volume up to which a grid resolves a shape; factor by which a coarser grid is refined; greatest
#: number of refinements.
_VOLUME_TOLERANCE, _MORE, _TIMES_MORE = 0.005, 1.5, 4
#: Number of grids with the same volume after which refinement stops.
_UNCHANGED = 3
#: Coarse blocks along the box in which the surface is searched first; fewer than in a final measurement.
_BLOCKS = 12
#: Cells between the surface and the box around it.
_MARGIN = 3
#: Points drawn on the surface at each end.
_POINTS = 4000


class Look(NamedTuple):
    """A surface and the volume inside it."""

    mesh: SimplexMesh
    volume: float


class Validation(NamedTuple):
    """Figures of one validation; all are finite.

    Attributes:
        curve: Volume over time.
        box: Corners of a box, within the training box, around the moving shape and all shapes that it passes through,
            shape (2, d).
        beyond: Volume beyond the training box, relative to that of the source; 0 where the surface keeps to the box.
        morph_to_shape: Mean distance from the surface of f at the time of each shape to that shape, a length.
        volume_std: Standard deviation over time of the volume, relative to that at t = 0.
        volume_max: Greatest deviation of the volume from that at t = 0, relative to it.
        volume_error: Greatest deviation of f's volume from that of a shape at its time, relative to it.
        drift: Displacement of the surface that makes the greater of the last two, a length; where the shapes have
            different volumes, none is wanted between them, and it is that of the last alone.
        components: Largest number of components at any of the times.
        leftover: Greatest volume share, and greatest distance, of components that neither the shape before nor the one
            after has.
    """

    curve: VolumeCurve
    box: Float[Tensor, "2 d"]
    beyond: float
    morph_to_shape: float
    volume_std: float
    volume_max: float
    volume_error: float
    drift: float
    components: int
    leftover: Leftover


class Validator:
    """Measures a morph in the whole training box, at evenly spaced times and at those of its shapes.

    Args:
        morph: The networks and the shapes.
        half_width: The training box is [−h, h]^d.
        resolution: Cells along the training box; thin shapes are measured with more.
        times: Number of evenly spaced times.
    """

    def __init__(self, morph: NeuralMorph, half_width: float, resolution: int, times: int) -> None:
        self.morph, self.times = morph, times_through(morph, times)
        #: Numbers of the times at which the morph must equal a shape.
        self.at_keys = [int((self.times - key.time).abs().argmin()) for key in morph.keys]
        corner = torch.full((morph.dim,), half_width)
        self._box, self._resolution = torch.stack([-corner, corner]), resolution

    @property
    def box(self) -> Float[Tensor, "2 d"]:
        """Corners of the training box."""
        return self._box.to(self.morph.bounds)

    def look(self, time: float) -> Look:
        """Extract the surface of the morph at one time."""
        return look_at(partial(self.morph, t=time), self.box, self.resolution)

    def validate(self, step: int) -> Validation:
        """Measure the morph after ``step`` steps, and warn of a missing surface or one that leaves the box."""
        looks = [self.look(time) for time in self.times.tolist()]
        volumes = torch.tensor([look.volume for look in looks], dtype=torch.double)
        pieces = [Pieces.of(look.mesh) for look in looks]
        relative = volumes / (volumes[0] if volumes[0] > 0 else self.key_volumes[0])
        deviation = float((relative - relative[0]).abs().max()) if volumes[0] > 0 else 1.0
        error = float((volumes[self.at_keys] / self.key_volumes - 1).abs().max())
        wrong = max(deviation, error) if self._have_one_volume else error
        leftovers = [piece.beyond(count) for piece, count in zip(pieces, self._expected(), strict=True)]
        self._warn_of_missing(volumes, step)
        return Validation(
            VolumeCurve(self.times, volumes),
            self._box_around([look.mesh for look in looks]),
            self._beyond(looks, step),
            self._morph_to_shape(looks),
            float(relative.std()),
            deviation,
            error,
            wrong * self._size / self.morph.dim,
            max(piece.components for piece in pieces),
            Leftover(max(left.share for left in leftovers), max(left.distance for left in leftovers)),
        )

    @cached_property
    def resolution(self) -> int:
        """Cells along the training box that resolve all shapes, wherever they lie relative to the cells."""
        true = self._true_volumes
        seen: dict[int, list[float]] = {}
        for resolution in (round(self._resolution * _MORE**times) for times in range(_TIMES_MORE + 1)):
            half_a_cell = (self.box[1] - self.box[0]) / resolution / 2
            grids = self.box, self.box + half_a_cell
            seen[resolution] = [look_at(shape, box, resolution).volume for box in grids for shape in self._shapes]
            error = _greatest_error(seen[resolution], true * len(grids))
            if error <= _VOLUME_TOLERANCE:
                return resolution
            # a volume that two refinements leave unchanged does not depend on the resolution
            last = list(seen)[-_UNCHANGED:]
            changes = [_greatest_error(seen[fine], seen[coarse]) for coarse, fine in pairwise(last)]
            if len(last) == _UNCHANGED and max(changes) <= _VOLUME_TOLERANCE:
                return last[0]
        log.warning(
            "A shape is so thin that its volume on %d cells along the training box is wrong by %.0f %%, and "
            "validation measures volumes roughly. Try `task.volume_resolution=%d`.",
            resolution,
            100 * error,
            2 * self._resolution,
        )
        return resolution

    @cached_property
    def key_volumes(self) -> Float[Tensor, " k"]:
        """Volumes (k,) of the shapes, measured like those of f; the true ones where the grid is too coarse."""
        measured = [look.volume or true for look, true in zip(self._key_looks, self._true_volumes, strict=True)]
        return torch.tensor(measured, dtype=torch.double)

    @cached_property
    def _true_volumes(self) -> list[float]:
        return [shape.volume() for shape in self._shapes]

    @property
    def _have_one_volume(self) -> bool:
        """Whether the volumes of the shapes differ by no more than a grid can tell."""
        return (
            _greatest_error(self._true_volumes, self._true_volumes[:1] * len(self._true_volumes)) <= _VOLUME_TOLERANCE
        )

    @property
    def _shapes(self) -> list[FieldShape]:
        return [key.shape for key in self.morph.keys]

    @cached_property
    def _key_looks(self) -> list[Look]:
        return [look_at(shape, self.box, self.resolution) for shape in self._shapes]

    @cached_property
    def _key_pieces(self) -> list[int]:
        """Number of components of each shape, at least one."""
        return [max(Pieces.of(look.mesh).components, 1) for look in self._key_looks]

    @property
    def _size(self) -> float:
        """Edge of a cube with the volume of the source, a length."""
        return float(self.key_volumes[0]) ** (1 / self.morph.dim)

    def _expected(self) -> list[int]:
        """Number of components that the morph may have at each time: as many as the shapes before and after."""
        expected = []
        for (first, before), (last, after) in pairwise(zip(self.at_keys, self._key_pieces, strict=True)):
            expected += [before, *[max(before, after)] * (last - first - 1)]
        return [*expected, after]

    def _morph_to_shape(self, looks: Sequence[Look]) -> float:
        """Mean of |g − f| at points of the meshes at the times of the shapes, where f is the error of the mesh.

        Without a surface, it is the diagonal of the training box.
        """
        distances = []
        for number, key in zip(self.at_keys, self.morph.keys, strict=True):
            look = looks[number]
            if not len(look.mesh.simplices):
                distances.append(float((self.box[1] - self.box[0]).norm()))
                continue
            generator = torch.Generator(self.box.device).manual_seed(0)
            points = sample_mesh(look.mesh, _POINTS, generator).points
            distances.append(float((evaluate(key.shape, points) - self.morph(points, key.time)).abs().mean()))
        return sum(distances) / len(distances)

    def _box_around(self, meshes: Sequence[SimplexMesh]) -> Float[Tensor, "2 d"]:
        seen = [*meshes, *(look.mesh for look in self._key_looks)]
        # slices pass through the center of the training box, so the box must hold it
        corners = torch.cat([mesh.vertices for mesh in seen] + [self.box.mean(0, keepdim=True)])
        margin = _MARGIN * (self.box[1] - self.box[0]) / self.resolution
        low = torch.maximum(corners.amin(0) - margin, self.box[0])
        return torch.stack([low, torch.minimum(corners.amax(0) + margin, self.box[1])])

    def _beyond(self, looks: Sequence[Look], step: int) -> float:
        """Greatest volume beyond the training box, relative to that of the source."""
        cut = [t for t, look in zip(self.times.tolist(), looks, strict=True) if open_sides(look.mesh, self.box)]
        if not cut:
            return 0.0
        found = [volume_beyond(partial(self.morph, t=time), self.box, self.resolution) for time in cut]
        share = max(found) / float(self.key_volumes[0])
        log.warning(
            "At step %d the moving shape leaves the training box [-%g, %g]^%d at t = %.2g, with about %.1f %% of its "
            "volume outside, where f is not trained. Try a larger `sampler.box.half_width`.",
            step, *(float(self.box[1, 0]),) * 2, self.morph.dim, cut[0], 100 * share,
        )  # fmt: skip
        return share

    def _warn_of_missing(self, volumes: Tensor, step: int) -> None:
        missing = [f"t = {self.times[number]:g}" for number in self.at_keys if not volumes[number] > 0]
        if missing:
            log.warning(
                "At step %d f has no surface at %s yet. Until it has one, val/error counts the distance as the "
                "diagonal of the training box, and all of the volume as lost.",
                step,
                " and ".join(missing),
            )


def look_at(field: SignedDistance, box: Float[Tensor, "2 d"], resolution: int) -> Look:
    """Extract the surface of a field and measure its volume, on ``resolution`` cells along a box."""
    band = sample_band(field, Lattice.corners(box, resolution), coarse=_BLOCKS)
    mesh = surface_in_band(band)
    # only a closed surface bounds a volume
    inside = volume(field, box, resolution) if open_sides(mesh, box) else volume_in_surface(mesh, field)
    return Look(mesh, max(inside, 0.0))


def _greatest_error(measured: Sequence[float], expected: Sequence[float]) -> float:
    """Greatest |measured / expected − 1|; infinite where nothing was expected."""
    return max(abs(m / e - 1) if e else math.inf for m, e in zip(measured, expected, strict=True))
