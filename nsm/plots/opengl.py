"""Offscreen OpenGL: find a way that works on this machine before VTK would end the process."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache

from nsm.cli.errors import InputError

#: Environment variable that selects the kind of window of VTK.
_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"
#: Draws one empty picture. Without OpenGL, VTK ends the process with a segmentation fault.
_TRIAL = """
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow
window = vtkRenderWindow()
window.OffScreenRenderingOn()
window.SetSize(8, 8)
window.AddRenderer(vtkRenderer())
window.Render()
raise SystemExit(not window.SupportsOpenGL())
"""
#: Seconds after which a trial counts as failed.
_TIMEOUT = 60


class NoOpenGLError(InputError):
    """Raised where this machine cannot draw surfaces."""


@cache
def require_opengl() -> None:
    """Configure VTK to draw offscreen, in a way that has succeeded in another process.

    Raises:
        NoOpenGLError: If none succeeds.
    """
    for window in _windows():
        environment = dict(os.environ) | ({_VARIABLE: window} if window else {})
        try:
            trial = subprocess.run([sys.executable, "-c", _TRIAL], env=environment, capture_output=True,
                                   timeout=_TIMEOUT)  # fmt: skip
        except subprocess.TimeoutExpired:
            continue
        if trial.returncode == 0:
            os.environ.update({_VARIABLE: window} if window else {})
            return
    raise NoOpenGLError(
        "Drawing surfaces needs OpenGL, which this machine lacks. Try `apt-get install libegl1 libgl1-mesa-dri` "
        "(Debian and Ubuntu), which renders without a graphics card."
    )


def _windows() -> list[str]:
    """Kinds of windows to try, best first; an empty name leaves the choice to VTK."""
    if chosen := os.environ.get(_VARIABLE):
        return [chosen]
    if sys.platform != "linux":
        return [""]
    return ["vtkEGLRenderWindow", *(["vtkXOpenGLRenderWindow"] if os.environ.get("DISPLAY") else [])]
