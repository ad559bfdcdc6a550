"""Callbacks that write files of a finished morph, however it was computed."""

from __future__ import annotations

from abc import ABC, abstractmethod

import lightning as L

from nsm.metrics import VolumeCurve
from nsm.train.callbacks.tracker import Trackers
from nsm.types import Morph


class MorphWriter(L.Callback, ABC):
    """Writes files of the morph that a run ends with, and shows them to trackers.

    Training calls it through Lightning; optimal transport, which has no steps, calls `write` itself.
    """

    @abstractmethod
    def write(self, morph: Morph, curve: VolumeCurve, label: str, trackers: Trackers) -> None:
        """Write the files.

        Args:
            morph: Morph that the run ends with.
            curve: Its volume over time.
            label: Name of the morph in legends.
            trackers: Trackers of the run, which get what they can show.
        """
