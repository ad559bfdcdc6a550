"""Drawing without a window: which way works on this machine, found out before VTK would end the process."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache

from nsm.cli.errors import InputError

#: The variable by which VTK is told how to draw.
_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"
#: Draws one empty picture; VTK ends a process that has no OpenGL by a fault of memory.
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
_PATIENCE = 60


class NoOpenGLError(InputError):
    """This machine cannot draw surfaces."""


@cache
def require_opengl() -> None:
    """Make VTK draw without a window, in a way that was tried in another process.

    Raises:
        NoOpenGLError: if there is none.
    """
    for window in _windows():
        environment = dict(os.environ) | ({_VARIABLE: window} if window else {})
        try:
            trial = subprocess.run([sys.executable, "-c", _TRIAL], env=environment, capture_output=True,
                                   timeout=_PATIENCE)  # fmt: skip
        except subprocess.TimeoutExpired:
            continue
        if trial.returncode == 0:
            os.environ.update({_VARIABLE: window} if window else {})
            return
    raise NoOpenGLError(
        "surfaces cannot be drawn, for there is no OpenGL on this machine: install its software version, on Debian and "
        "Ubuntu by apt-get install libegl1 libgl1-mesa-dri"
    )


def _windows() -> list[str]:
    """Kinds of windows of VTK to try, best first; an empty name leaves the choice to VTK."""
    if chosen := os.environ.get(_VARIABLE):
        return [chosen]
    if sys.platform != "linux":
        return [""]
    return ["vtkEGLRenderWindow", *(["vtkXOpenGLRenderWindow"] if os.environ.get("DISPLAY") else [])]
