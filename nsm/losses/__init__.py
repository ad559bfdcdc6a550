"""Loss terms, and their weighted sum."""

from nsm.losses.base import Evaluation, OverBatch, Term, WeightedSum
from nsm.losses.boundary import AmbientDirichlet, EndVolume, Neumann, NormalAlignment, NormalMatch, SurfaceDirichlet
from nsm.losses.divergence import Divergence
from nsm.losses.eikonal import Eikonal
from nsm.losses.level_set import LevelSet
from nsm.losses.official import DecoupledEikonal, OfficialDirichlet

__all__ = [
    "AmbientDirichlet",
    "DecoupledEikonal",
    "Divergence",
    "Eikonal",
    "EndVolume",
    "Evaluation",
    "LevelSet",
    "Neumann",
    "NormalAlignment",
    "NormalMatch",
    "OfficialDirichlet",
    "OverBatch",
    "SurfaceDirichlet",
    "Term",
    "WeightedSum",
]
