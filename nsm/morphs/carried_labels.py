"""Volumes of labels carried along the velocity of a morph, on their own grid."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.geometry.advection import advect
from nsm.geometry.flow import FlowMaps
from nsm.morphs.advected import velocity_of
from nsm.morphs.file_coordinates import ENDS
from nsm.shapes import FieldShape, Similarity
from nsm.shapes.volume_files import Voxels
from nsm.types import Morph

#: Default number of cells along the box on which V is sampled.
FLOW_RESOLUTION = 64
#: Number of times at which V is sampled.
_SLICES = 9
#: Number of voxels carried at once.
_CHUNK = 1 << 18
#: Number of voxels at which the flow maps are compared with direct integration.
_CHECKED = 256


class CarriedLabels:
    """Labels of a volume in the file of an end, carried to other times by the flow φ of V.

    The label of a voxel with center x at time t is that of the voxel nearest to φ_{t→s}(x), where s is the time of the
    end, 0 for the source and 1 for the target: nearest-label resampling along the backward flow. Beyond the grid there
    is label 0. φ comes from `nsm.geometry.flow.FlowMaps` over the box of the morph; voxels outside of that box, where V
    is not known, are displaced as the nearest point of the box.

    Args:
        morph: A morph in 3D with a velocity.
        voxels: Labels, and the matrix that places them in the coordinates of the end's file.
        end: ``source`` or ``target``.
        resolution: Cells along the longest edge of the box on which V is sampled.

    Raises:
        InputError: If the morph has no velocity, or its end no file.
    """

    def __init__(self, morph: Morph, voxels: Voxels, end: str, resolution: int = FLOW_RESOLUTION) -> None:
        shape = {"source": morph.source, "target": morph.target}[end]
        if not isinstance(shape, FieldShape):
            raise InputError(
                f"`morph` must have a {end} with a file, got a {type(shape).__name__}. Try a morph of `nsm.load_morph`."
            )
        self.voxels, self.start = voxels, float(ENDS.index(end))
        self._velocity, self._bounds, self._resolution = velocity_of(morph), morph.bounds, resolution
        self._to_box = torch.from_numpy(_matrix(shape.similarity) @ voxels.affine)
        self._from_box = torch.linalg.inv(self._to_box)

    def at(self, time: float) -> np.ndarray:
        """Carry the labels to a time; the result has the type and the shape (i, j, k) of the given ones."""
        values, carried = self.voxels.values, np.zeros_like(self.voxels.values)
        window = self._window(time)
        shape = tuple(part.stop - part.start for part in window)
        low, size = torch.tensor([part.start for part in window]), torch.tensor(values.shape)
        found = np.empty(math.prod(shape), dtype=values.dtype)
        for rows in torch.arange(len(found)).split(_CHUNK):
            index = torch.stack(torch.unravel_index(rows, shape), 1) + low
            origin = self._traced(index, time)
            there = ((origin >= 0) & (origin < size)).all(1)
            nearest = tuple(torch.minimum(origin.clamp(min=0), size - 1).T.numpy())
            found[rows.numpy()] = np.where(there.numpy(), values[nearest], 0)
        carried[window] = found.reshape(shape)
        return carried

    @torch.no_grad()
    def flow_error(self, time: float) -> float:
        """Greatest distance, in voxels, between points traced back by the flow maps and by integration of V itself."""
        labeled = torch.from_numpy(np.argwhere(self.voxels.values))
        x = _apply(self._to_box, labeled[:: max(1, len(labeled) // _CHECKED)].double())
        x = x[((x > self._bounds[0]) & (x < self._bounds[1])).all(1)]
        if not len(x):
            return 0.0
        direct = advect(self._velocity, x, [time, self.start])[-1]
        traced = x + self._displacements(x, time)
        return float(((direct - traced) @ self._from_box[:3, :3].T).norm(dim=1).max())

    def outside(self) -> float:
        """Share of the labeled voxels that lie outside of the box, where V is not known."""
        labeled = torch.from_numpy(np.argwhere(self.voxels.values)).double()
        x = _apply(self._to_box, labeled)
        return 1 - float(((x >= self._bounds[0]) & (x <= self._bounds[1])).all(1).double().mean())

    @cached_property
    def _flow(self) -> FlowMaps:
        return FlowMaps(self._velocity, self._bounds, self._resolution, _SLICES)

    def _traced(self, index: Tensor, time: float) -> Tensor:
        """Indices of the voxels nearest to where voxels at a time come from, both (n, 3)."""
        x = _apply(self._to_box, index.double())
        return _apply(self._from_box, x + self._displacements(x, time)).round().long()

    def _displacements(self, x: Float[Tensor, "n 3"], time: float) -> Float[Tensor, "n 3"]:
        columns = slice(3 * int(self.start), 3 * int(self.start) + 3)
        return self._flow.at(time)(x.to(self._bounds))[:, columns].double().cpu()

    def _window(self, time: float) -> tuple[slice, ...]:
        """Part of the grid that labels other than 0 can reach."""
        nodes = self._flow.lattice.points(self._flow.lattice.indices())
        moved = (self._displacements(nodes, time) @ self._from_box[:3, :3].T).abs().amax(0)
        margin = (1.5 * moved).ceil().long().numpy() + 1  # cubics overshoot a little
        window = []
        for axis, count in enumerate(self.voxels.values.shape):
            filled = np.flatnonzero(self.voxels.values.any(axis=tuple(a for a in range(3) if a != axis)))
            low, high = filled[0] - margin[axis], filled[-1] + 1 + margin[axis]
            window.append(slice(max(0, int(low)), min(count, int(high))))
        return tuple(window)


def _matrix(similarity: Similarity) -> np.ndarray:
    """The matrix, shape (4, 4), of a similarity in space."""
    matrix = np.eye(4)
    matrix[:3, :3] = similarity.scale * similarity.rotation.numpy()
    matrix[:3, 3] = similarity.translation.numpy()
    return matrix


def _apply(matrix: Tensor, x: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    return x @ matrix[:3, :3].T + matrix[:3, 3]
