"""Files that people open: meshes, curves, pictures. Each appears whole or not at all."""

from nsm.writers.curves import plot_volume_curves, write_volume_curve
from nsm.writers.frames import extract_frame, save_frame
from nsm.writers.mesh import write_mesh
from nsm.writers.strip import render_strip

__all__ = [
    "extract_frame",
    "plot_volume_curves",
    "render_strip",
    "save_frame",
    "write_mesh",
    "write_volume_curve",
]
