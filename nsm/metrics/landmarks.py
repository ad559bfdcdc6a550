"""Landmarks of a morph, advected by V."""

from __future__ import annotations

from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.geometry.advection import VelocityField, advect
from nsm.shapes import FieldShape, LandmarkPairs
from nsm.types import Morph


@torch.no_grad()
def landmark_errors(morph: Morph) -> Float[Tensor, " k"] | None:
    """Distances between the landmarks of the source, advected by V to t = 1, and those of the target.

    Args:
        morph: A morph that was trained with landmarks, which its provenance keeps in the coordinates of both files.

    Returns:
        One distance per landmark in the coordinates of the morph; None for a morph without landmarks or velocity.
    """
    known, ends = morph.provenance.get("landmarks"), (morph.source, morph.target)
    if known is None or not morph.has_velocity or not all(isinstance(end, FieldShape) for end in ends):
        return None
    source, target = LandmarkPairs.read_provenance(known).place(*cast(tuple[FieldShape, FieldShape], ends))
    arrived = advect(cast(VelocityField, morph.velocity), source.to(morph.bounds), [0.0, 1.0])[-1]
    return (arrived - target.to(arrived)).norm(dim=1)
