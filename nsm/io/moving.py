"""What the formats for moving surfaces share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.types import SimplexMesh

#: The color of clay in amounts of light: red, green, blue.
CLAY = (0.62, 0.45, 0.34)


def playing_times(times: Sequence[float], seconds: float) -> np.ndarray:
    """When each frame is due (k,), in seconds from the start.

    Args:
        times: of the frames, increasing.
        seconds: from the first frame to the last.

    Raises:
        InputError: if the times do not increase.
    """
    moments = np.asarray(times, dtype=np.float64)
    if not bool((np.diff(moments) > 0).all()):
        raise InputError(f"times={list(times)} cannot be played: give times that increase, such as times=[0,0.5,1]")
    if len(moments) < 2:
        return np.zeros(len(moments))
    return seconds * (moments - moments[0]) / (moments[-1] - moments[0])


def is_closed(mesh: SimplexMesh) -> bool:
    """Whether every edge of a surface has two triangles, so that its back is never seen."""
    faces = mesh.simplices.cpu().numpy()
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] == 2).all())


def linear_rgb(colors: Float[Tensor, "v 3"]) -> Float[Tensor, "v 3"]:
    """Colors in amounts of light, as glTF and USD take them at vertices, from sRGB (IEC 61966-2-1)."""
    return torch.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
