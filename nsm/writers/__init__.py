"""Files that people open: meshes, curves, pictures. Each appears whole or not at all."""

from nsm.writers.curves import plot_volume_curves, write_volume_curve
from nsm.writers.mesh import write_mesh
from nsm.writers.strip import render_strip

__all__ = [
    "plot_volume_curves",
    "render_strip",
    "write_mesh",
    "write_volume_curve",
]
