"""Morphs by optimal transport between two shapes, which need no training."""

from nsm.morphs.optimal_transport.entropic import EntropicMap, entropic_maps
from nsm.morphs.optimal_transport.morph import TransportMorph
from nsm.morphs.optimal_transport.solver import OptimalTransport

__all__ = ["EntropicMap", "OptimalTransport", "TransportMorph", "entropic_maps"]
