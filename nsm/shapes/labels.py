"""Shapes from labeled volumes."""

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

#: Number of distinct values above which a volume is a scan, not a segmentation.
MAX_LABELS = 5000
#: Maximum number of labels listed in a message.
LISTED = 20


class LabelVolume(MeshShape):
    """A labeled region of a voxel volume, bounded by a mesh in the coordinates of the scanner.

    The surface (`nsm.shapes.label_surface`) has the volume of the voxels of the region. Spacing and orientation are
    those of the file, so that the inverse of the similarity in the provenance returns results in millimeters.

    Args:
        path: NIfTI, MGH, NRRD, or TIFF file of several pages.
        label: Label of the region, or several labels that form it together; None for the only label other than 0.
        spacing: Distances between voxels along the three axes, which replace the coordinates of the file.
        fit: Half the longest side of the bounding box after fitting; None keeps the coordinates of the scanner.
        pose: Rotation, translation, and scale applied after fitting.
        up: Direction in the coordinates of the file that becomes +y, before all else; None for +y.

    Raises:
        InputError: If the file is not a volume of labels, or does not contain the label.
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


def known_labels(values: np.ndarray, name: str) -> list[int]:
    """List the labels of a volume except for 0, the background, in increasing order.

    Args:
        values: Labels of all voxels.
        name: Name of the file, for messages.

    Raises:
        InputError: If the values are not labels, or all are 0.
    """
    present = np.unique(values)
    if len(present) > MAX_LABELS or not (np.isfinite(present).all() and (present == np.round(present)).all()):
        raise InputError(
            f"`{name}` must hold whole numbers, the labels of its voxels, got {len(present)} different values between "
            f"{present[0]:g} and {present[-1]:g}. Try a segmentation in place of the scan."
        )
    known = [int(value) for value in present if value != 0]
    if not known:
        raise InputError(f"`{name}` must hold a label other than 0, got none. Try another segmentation.")
    return known


def choose_labels(values: np.ndarray, label: int | Sequence[int] | None, name: str) -> list[int]:
    """Determine the labels that form the region.

    Args:
        values: Labels of all voxels; 0 is the background.
        label: One label, several labels, or None for the only one.
        name: Name of the file, for messages.

    Raises:
        InputError: If a label is not in the volume, none of several is chosen, or the values are not labels.
    """
    known = known_labels(values, name)
    listed = ", ".join(map(str, known[:LISTED])) + (", …" if len(known) > LISTED else "")
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
    """Extract vertices in the coordinates of the scanner, and triangles with outward normals."""
    surface = label_surface(mask)
    vertices = surface.vertices @ voxels.affine[:3, :3].T + voxels.affine[:3, 3]
    mirrored = np.linalg.det(voxels.affine[:3, :3]) < 0
    return vertices, surface.faces[:, ::-1].copy() if mirrored else surface.faces


def _report_cut(mask: np.ndarray, name: str) -> None:
    """Warn about a region that reaches the border of the volume, where a flat face closes it."""
    faces = [mask.take(end, axis=axis).any() for axis in range(3) for end in (0, -1)]
    if any(faces):
        log.warning("the region in %s reaches %d faces of the volume: it is cut and closed there", name, sum(faces))
