"""Networks, velocities, and the functions β."""

from nsm.fields.beta import Beta, Gaussian, Quadratic, Quartic, Rational
from nsm.fields.init import OfficialInit, OwnInit, SirenInit, SourceInit
from nsm.fields.lipschitz import LipschitzMlp
from nsm.fields.mirror import Mirror
from nsm.fields.scalar import ScalarNetwork
from nsm.fields.siren import ScalarSiren, Siren, VectorSiren
from nsm.fields.symmetric import SymmetricField, SymmetricVelocity
from nsm.fields.velocity import AdaDiv, Free, LearnedVelocity, Nise, NullDiv, Velocity

__all__ = [
    "AdaDiv",
    "Beta",
    "Free",
    "Gaussian",
    "LearnedVelocity",
    "LipschitzMlp",
    "Mirror",
    "Nise",
    "NullDiv",
    "OfficialInit",
    "OwnInit",
    "Quadratic",
    "Quartic",
    "Rational",
    "ScalarNetwork",
    "ScalarSiren",
    "Siren",
    "SirenInit",
    "SourceInit",
    "SymmetricField",
    "SymmetricVelocity",
    "VectorSiren",
    "Velocity",
]
