"""Networks, and the fields made of them."""

from nsm.fields.beta import Beta, Gaussian, Quadratic, Quartic, Rational
from nsm.fields.init import OfficialInit, SirenInit, SourceInit
from nsm.fields.siren import ScalarSiren, Siren, VectorSiren
from nsm.fields.velocity import AdaDiv, Free, NullDiv, Velocity

__all__ = [
    "AdaDiv",
    "Beta",
    "Free",
    "Gaussian",
    "NullDiv",
    "OfficialInit",
    "Quadratic",
    "Quartic",
    "Rational",
    "ScalarSiren",
    "Siren",
    "SirenInit",
    "SourceInit",
    "VectorSiren",
    "Velocity",
]
