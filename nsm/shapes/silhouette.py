"""Shapes in 2D from images and drawings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from nsm.cli.errors import InputError
from nsm.shapes.download import file_sha256, resolve
from nsm.shapes.image_outline import IMAGE_FORMATS, image_outline
from nsm.shapes.outline import OutlineShape
from nsm.shapes.placing import FilePlacement, centered
from nsm.shapes.reading import require_content
from nsm.shapes.similarity import Pose, Similarity
from nsm.shapes.svg_outline import svg_outline

#: Extensions of supported files.
PICTURE_FORMATS = (*IMAGE_FORMATS, ".svg")


class Silhouette(OutlineShape):
    """The region shown by an image or drawing, with exact distances to its outline; it may have holes.

    The coordinates of an image are pixels from its lower left corner; those of an SVG drawing have y pointing upward.

    Args:
        path: Image with transparency or with a background of one brightness, or SVG drawing of filled paths.
        threshold: Opacity or brightness in (0, 1) at which the inside of an image begins; None for an automatic choice.
        fit: Half the longest side of the bounding box after fitting; None keeps the coordinates of the file.
        pose: Rotation, translation, and scale applied after fitting.
        up: Direction in the coordinates of the file that becomes +y, before all else; None for +y.

    Raises:
        InputError: If the file is not an image or drawing, or shows no region.
    """

    def __init__(
        self,
        path: str,
        threshold: float | None = None,
        fit: float | None = 0.8,
        pose: Pose = None,
        up: Sequence[float] | None = None,
    ) -> None:
        place, file = FilePlacement(fit, pose, up, dim=2), resolve(path)
        suffix = file.suffix.lower()
        if suffix not in PICTURE_FORMATS:
            raise InputError(
                f"The name of a picture must end in {', '.join(PICTURE_FORMATS)}, got '{file.suffix}' ({file}). Try "
                "`silhouette.png`."
            )
        require_content(file, "a picture")
        if suffix == ".svg" and threshold is not None:
            raise InputError(f"`threshold` must be null for a drawing, got {threshold:g}. Try `threshold=null`.")
        loops = svg_outline(file) if suffix == ".svg" else image_outline(file, threshold)
        vertices, center = centered(torch.from_numpy(np.concatenate(loops)))
        placement = place.of_centered(vertices, center)
        origin = {"kind": "silhouette", "path": str(path), "sha256": file_sha256(file)}
        pose = placement.after(Similarity.shift(-center))
        super().__init__(len(vertices), [len(loop) for loop in loops], pose, placement, origin)
        self.vertices.copy_(vertices)
