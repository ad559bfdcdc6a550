"""Files that people open: meshes, curves, pictures. Each appears whole or not at all."""

from nsm.writers.curves import plot_curves, plot_volume_curves, write_volume_curve
from nsm.writers.evaluation import write_evaluations
from nsm.writers.film import Pace, render_film, render_turntable
from nsm.writers.gltf import write_glb_carried, write_glb_frames
from nsm.writers.look import Look
from nsm.writers.mesh import write_mesh
from nsm.writers.slices import Plane, plot_residual_slices, require_slices
from nsm.writers.strip import render_strip, try_strip
from nsm.writers.usd import write_usd_carried, write_usd_frames

__all__ = [
    "Look",
    "Pace",
    "Plane",
    "plot_curves",
    "plot_residual_slices",
    "plot_volume_curves",
    "render_film",
    "render_strip",
    "render_turntable",
    "require_slices",
    "try_strip",
    "write_evaluations",
    "write_glb_carried",
    "write_glb_frames",
    "write_mesh",
    "write_usd_carried",
    "write_usd_frames",
    "write_volume_curve",
]
