"""Timing and topology that the formats for animated surfaces share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nsm.cli.settings import increasing
from nsm.types import SimplexMesh


def playing_times(times: Sequence[float], seconds: float) -> np.ndarray:
    """Map times of a morph to seconds of its animation, linearly, so that the first frame is shown at 0.

    Args:
        times: Times of the frames, increasing, shape (k,).
        seconds: Seconds from the first frame to the last.

    Returns:
        Seconds at which each frame is shown, shape (k,).

    Raises:
        InputError: If the times do not increase.

    >>> playing_times([0.5, 0.75, 1.0], seconds=3.0).tolist()
    [0.0, 1.5, 3.0]
    """
    moments = np.array(increasing("times", times), dtype=np.float64)
    if len(moments) < 2:
        return np.zeros(len(moments))
    return seconds * (moments - moments[0]) / (moments[-1] - moments[0])


def is_closed(mesh: SimplexMesh) -> bool:
    """Tell whether every edge of a triangle mesh has two triangles, so that its back is never visible."""
    faces = mesh.simplices.cpu().numpy()
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] == 2).all())
