"""Loss terms, one module per equation, and their weighted sum."""

from nsm.losses.base import Everywhere, OverBatch, Ramp, Term, WeightedSum
from nsm.losses.dirichlet import AmbientDirichlet, SurfaceDirichlet
from nsm.losses.divergence import Compression, Divergence
from nsm.losses.eikonal import Eikonal, EndEikonal
from nsm.losses.end_volume import EndVolume
from nsm.losses.evaluation import BatchEvaluation
from nsm.losses.landmarks import LandmarkMatch
from nsm.losses.level_set import LevelSet, ModifiedLevelSet
from nsm.losses.lipschitz import LipschitzBound
from nsm.losses.neumann import Neumann, NormalAlignment, NormalMatch
from nsm.losses.official import (
    DecoupledEikonal,
    OfficialDirichlet,
    OfficialDivergence,
    OfficialNeumann,
    OfficialSmoothness,
)
from nsm.losses.smoothness import Smoothness

__all__ = [
    "AmbientDirichlet",
    "BatchEvaluation",
    "Compression",
    "DecoupledEikonal",
    "Divergence",
    "Eikonal",
    "EndEikonal",
    "EndVolume",
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
