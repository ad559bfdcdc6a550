"""Methods of others that need no training: optimal transport."""

from nsm.baselines.entropic import EntropicMap, entropic_maps
from nsm.baselines.optimal_transport import OptimalTransport
from nsm.baselines.run import transport_run
from nsm.baselines.transport_morph import TransportMorph

__all__ = ["EntropicMap", "OptimalTransport", "TransportMorph", "entropic_maps", "transport_run"]
