"""Volume-preserving neural shape morphing.

>>> import nsm
>>> morph = nsm.morph("a.obj", "b.obj")  # doctest: +SKIP
>>> morph.mesh(0.5)  # doctest: +SKIP
<trimesh.Trimesh(vertices.shape=(30414, 3), faces.shape=(60824, 3))>
>>> morph.save("film.mp4")  # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from nsm.cli.runtime import share_cores

if TYPE_CHECKING:
    from nsm.cli.errors import InputError
    from nsm.io.checkpoint import load_shape
    from nsm.io.mesh import write_mesh
    from nsm.library import TrainedMorph, load_morph, load_official, morph
    from nsm.metrics.evaluation import evaluate_morph
    from nsm.metrics.volume_curve import volume_curve
    from nsm.morphs.advected import advect_mesh
    from nsm.morphs.exact_ends import ExactEnds
    from nsm.morphs.exact_keys import ExactKeys
    from nsm.morphs.file_coordinates import FileCoordinates
    from nsm.morphs.surfaces import extract_frame
    from nsm.shapes import MeshFile, PointCloud
    from nsm.types import Morph

share_cores()  # before anything imports torch

__version__ = "0.1.0"
__all__ = [
    "ExactEnds",
    "ExactKeys",
    "FileCoordinates",
    "InputError",
    "MeshFile",
    "Morph",
    "PointCloud",
    "TrainedMorph",
    "__version__",
    "advect_mesh",
    "evaluate_morph",
    "extract_frame",
    "load_morph",
    "load_official",
    "load_shape",
    "morph",
    "volume_curve",
    "write_mesh",
]

#: The module that defines each name; it is imported on first use, so that `import nsm` stays light. No module of the
#: package may share a name with them: importing `nsm.morph` would replace the function.
_MODULES = {
    "ExactEnds": "nsm.morphs.exact_ends",
    "ExactKeys": "nsm.morphs.exact_keys",
    "FileCoordinates": "nsm.morphs.file_coordinates",
    "InputError": "nsm.cli.errors",
    "MeshFile": "nsm.shapes",
    "Morph": "nsm.types",
    "PointCloud": "nsm.shapes",
    "TrainedMorph": "nsm.library",
    "advect_mesh": "nsm.morphs.advected",
    "evaluate_morph": "nsm.metrics.evaluation",
    "extract_frame": "nsm.morphs.surfaces",
    "load_morph": "nsm.library",
    "load_official": "nsm.library",
    "load_shape": "nsm.io.checkpoint",
    "morph": "nsm.library",
    "volume_curve": "nsm.metrics.volume_curve",
    "write_mesh": "nsm.io.mesh",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
