"""A page in the browser that shows morphs while their frames are computed, and recordings of it in one file."""

from nsm.viewer.frames import COLOURS, Settings
from nsm.viewer.page import Viewer, free_port
from nsm.viewer.recording import record

__all__ = ["COLOURS", "Settings", "Viewer", "free_port", "record"]
