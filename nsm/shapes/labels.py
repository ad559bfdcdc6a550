"""Shapes that are labels of a volume."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
import torch

from nsm.cli.errors import InputError
from nsm.shapes.download import file_sha256, resolve
from nsm.shapes.label_surface import label_surface
from nsm.shapes.mesh import MeshShape
from nsm.shapes.placing import FilePlacement, centered
from nsm.shapes.similarity import Pose, Similarity
from nsm.shapes.volume_files import Voxels, read_voxels, spaced

log = logging.getLogger(__name__)

#: A volume with more values than this is a picture, not a volume of labels.
MOST_LABELS = 5000
#: As many labels are listed in a message.
LISTED = 20


class LabelVolume(MeshShape):
    """A labelled region of a volume of voxels, bounded by a mesh in the coordinates of the scanner.

    The surface (`nsm.shapes.label_surface`) has the volume of the voxels of the region. Spacing and orientation are
    those of the file, so that the inverse of the similarity of the provenance returns results in its millimeters.

    Args:
        path: NIfTI, MGH, NRRD, or TIFF file of several pages.
        label: Label of the region, or several that make it together; None takes the only one that is not 0.
        spacing: Distances between voxels along the three axes, in place of what the file says of its coordinates.
        fit: Half of the longest side after fitting; None keeps the coordinates of the scanner.
        pose: Rotation, translation, and scale given to the region after that.
        up: Direction in the coordinates of the file that becomes +y, before all else; None if it is +y already.

    Raises:
        InputError: If the file is no volume of labels, or does not hold the label.
    """

    def __init__(
        self,
        path: str,
        label: int | Sequence[int] | None = None,
        spacing: Sequence[float] | None = None,
        fit: float | None = 0.8,
        pose: Pose = None,
        up: Sequence[float] | None = None,
    ) -> None:
        place, file = FilePlacement(fit, pose, up), resolve(path)
        voxels = read_voxels(file)
        chosen = choose_labels(voxels.values, label, str(path))
        mask = np.isin(voxels.values, chosen)
        _report_cut(mask, str(path))
        raw, faces = _in_scanner(voxels if spacing is None else Voxels(voxels.values, spaced(spacing)), mask)
        vertices, center = centered(torch.from_numpy(raw))
        placement = place.of_centered(vertices, center)
        origin = {"kind": "labels", "path": str(path), "sha256": file_sha256(file), "label": chosen}
        pose = placement.after(Similarity.shift(-center))
        super().__init__(len(vertices), len(faces), True, pose, placement, origin)
        self.vertices.copy_(vertices)
        self.faces.copy_(torch.from_numpy(faces))


def choose_labels(values: np.ndarray, label: int | Sequence[int] | None, name: str) -> list[int]:
    """The labels that make the region.

    Args:
        values: Labels of all voxels; 0 is the background.
        label: One, several, or None for the only one there is.
        name: Of the file, for messages.

    Raises:
        InputError: If a label is not in the volume, there are several and none is chosen, or the values are no labels.
    """
    present = np.unique(values)
    if len(present) > MOST_LABELS or not (np.isfinite(present).all() and (present == np.round(present)).all()):
        raise InputError(
            f"{name} must hold whole numbers, the labels of its voxels, got {len(present)} different values between "
            f"{present[0]:g} and {present[-1]:g}. Try a segmentation in place of the scan."
        )
    known = [int(value) for value in present if value != 0]
    listed = ", ".join(map(str, known[:LISTED])) + (", …" if len(known) > LISTED else "")
    if not known:
        raise InputError(f"{name} must hold a label other than 0, got none. Try another segmentation.")
    if label is None:
        if len(known) > 1:
            raise InputError(f"`label` must be one of {listed} in {name}, got none. Try `label={known[0]}`.")
        return known
    chosen = [int(each) for each in ([label] if isinstance(label, int) else label)]
    if missing := [each for each in chosen if each not in known]:
        raise InputError(f"`label` must be one of {listed} in {name}, got {missing[0]}. Try `label={known[0]}`.")
    if not chosen:
        raise InputError(f"`label` must be one or several of {listed} in {name}, got []. Try `label={known[0]}`.")
    return chosen


def _in_scanner(voxels: Voxels, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices in the coordinates of the scanner, and triangles with normals outwards there."""
    surface = label_surface(mask)
    vertices = surface.vertices @ voxels.affine[:3, :3].T + voxels.affine[:3, 3]
    mirrored = np.linalg.det(voxels.affine[:3, :3]) < 0
    return vertices, surface.faces[:, ::-1].copy() if mirrored else surface.faces


def _report_cut(mask: np.ndarray, name: str) -> None:
    """Warn of a region that reaches the border of the volume, where it is closed by a flat face."""
    faces = [mask.take(end, axis=axis).any() for axis in range(3) for end in (0, -1)]
    if any(faces):
        log.warning("the region in %s reaches %d faces of the volume: it is cut and closed there", name, sum(faces))
