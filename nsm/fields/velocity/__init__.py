"""Velocity fields V(x, t), one module each."""

from nsm.fields.velocity.adadiv import AdaDiv
from nsm.fields.velocity.base import LearnedVelocity, NetworkFactory, Velocity
from nsm.fields.velocity.free import Free
from nsm.fields.velocity.nise import Nise
from nsm.fields.velocity.nulldiv import NullDiv

__all__ = ["AdaDiv", "Free", "LearnedVelocity", "NetworkFactory", "Nise", "NullDiv", "Velocity"]
