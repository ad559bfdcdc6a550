"""Loss terms, and their weighted sum."""

from nsm.losses.base import Evaluation, Everywhere, OverBatch, Ramp, Term, WeightedSum
from nsm.losses.boundary import AmbientDirichlet, EndVolume, Neumann, NormalAlignment, NormalMatch, SurfaceDirichlet
from nsm.losses.divergence import Divergence
from nsm.losses.eikonal import Eikonal, EndEikonal
from nsm.losses.insd import Compression, LandmarkMatch, ModifiedLevelSet, Smoothness
from nsm.losses.level_set import LevelSet
from nsm.losses.lipschitz import LipschitzBound
from nsm.losses.official import (
    DecoupledEikonal,
    OfficialDirichlet,
    OfficialDivergence,
    OfficialNeumann,
    OfficialSmoothness,
)

__all__ = [
    "AmbientDirichlet",
    "Compression",
    "DecoupledEikonal",
    "Divergence",
    "Eikonal",
    "EndEikonal",
    "EndVolume",
    "Evaluation",
    "Everywhere",
    "LandmarkMatch",
    "LevelSet",
    "LipschitzBound",
    "ModifiedLevelSet",
    "Neumann",
    "NormalAlignment",
    "NormalMatch",
    "OfficialDirichlet",
    "OfficialDivergence",
    "OfficialNeumann",
    "OfficialSmoothness",
    "OverBatch",
    "Ramp",
    "Smoothness",
    "SurfaceDirichlet",
    "Term",
    "WeightedSum",
]
