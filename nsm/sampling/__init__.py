"""Training points: pools of precomputed targets, and batches drawn from them."""

from nsm.sampling.batch import Batch, Fractions, MorphSampler, SdfSampler
from nsm.sampling.domain import Box, UniformTime
from nsm.sampling.moving import EndSurfaces, MovingSurface, nearest_key
from nsm.sampling.pools import Pools

__all__ = [
    "Batch",
    "Box",
    "EndSurfaces",
    "Fractions",
    "MorphSampler",
    "MovingSurface",
    "Pools",
    "SdfSampler",
    "UniformTime",
    "nearest_key",
]
