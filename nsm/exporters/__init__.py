"""What ``python -m nsm.export`` can write: files of meshes, animations, and the fields themselves."""

from nsm.exporters.animation import Animation
from nsm.exporters.base import Format, Request
from nsm.exporters.program import Program
from nsm.exporters.sequence import Meshes

__all__ = ["Animation", "Format", "Meshes", "Program", "Request"]
