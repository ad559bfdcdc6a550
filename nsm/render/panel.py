"""Panels of a film: each draws one morph at any time and angle, always at the same size."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from types import TracebackType

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from nsm.plots.flat import LevelSetDrawing
from nsm.plots.look import Look, camera_for, surface
from nsm.plots.renderer import Surface, SurfaceRenderer
from nsm.types import Morph

_DPI = 100
#: Height of letters relative to the caption, and of a caption relative to its panel.
_LETTERS, _NAME = 0.45, 0.06


class Panel(ABC):
    """Part of each frame of a film that shows one morph; a context manager."""

    @abstractmethod
    def draw(self, time: float, angle: float) -> np.ndarray:
        """Draw a time, turned by an angle in radians, as sRGB pixels of 8 bits (height, width, 3)."""

    def __enter__(self) -> Panel:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    @abstractmethod
    def close(self) -> None:
        """Free the resources of the panel."""


class SurfacePanel(Panel):
    """Panel of a surface, which turns about its vertical axis; camera and lamps do not move.

    Args:
        morph: A morph of three dimensions.
        name: Caption, omitted if empty.
        size: Width and height in pixels.
        look: Resolution, levels, colors, and camera.
        times: Times at which the surface must fit into the picture; None for all.
        turning: Whether it must fit at every angle.
    """

    def __init__(
        self, morph: Morph, name: str, size: tuple[int, int], look: Look, times: Sequence[float] | None, turning: bool
    ) -> None:
        width, height = size
        self._title = _title(name, size)
        height -= len(self._title)
        self._morph, self._look, self._levels = morph, look, look.levels(morph)
        self._camera = camera_for(morph, look, times, height / width, turning)
        self._renderer = SurfaceRenderer(self._camera, width)
        self._last: tuple[float, Surface] | None = None

    def draw(self, time: float, angle: float) -> np.ndarray:
        if self._last is None or self._last[0] != time:
            self._last = (time, surface(self._morph, time, self._levels(time), self._look))
        still = self._last[1]
        turned = still._replace(
            vertices=self._camera.turned(still.vertices, angle), normals=still.normals @ self._camera.turn(angle).T
        )
        return np.concatenate([self._title, self._renderer.draw(turned)])

    def close(self) -> None:
        self._renderer.close()


class LevelSetPanel(Panel):
    """Panel of a 2D shape, which does not turn.

    Args:
        morph: A morph of two dimensions.
        name: Caption, omitted if empty.
        size: Width and height in pixels.
        look: Resolution, levels, and colors.
    """

    def __init__(self, morph: Morph, name: str, size: tuple[int, int], look: Look) -> None:
        self._title = _title(name, size)
        self._size = (size[0], size[1] - len(self._title))
        self._drawing = LevelSetDrawing(morph, look)

    def draw(self, time: float, angle: float) -> np.ndarray:
        width, height = self._size
        figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
        # the largest rectangle of the drawing's aspect, with a margin
        wide = 0.94 * min(width, height / self._drawing.aspect)
        tall = wide * self._drawing.aspect
        axis = figure.add_axes((0.5 - wide / width / 2, 0.5 - tall / height / 2, wide / width, tall / height))
        self._drawing.draw(axis, time, line=0.0035 * wide)
        axis.spines[:].set(color="0.8", linewidth=0.001 * wide)
        return np.concatenate([self._title, pixels(figure)])

    def close(self) -> None:
        """Do nothing: there are no resources to free."""


def caption(text: str, size: tuple[int, int]) -> np.ndarray:
    """Draw a line of text, centered on white, as pixels (height, width, 3); ``size`` is width and height."""
    width, height = size
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    figure.text(0.5, 0.5, text, ha="center", va="center", fontsize=_LETTERS * height * 72 / _DPI, color="0.15")
    return pixels(figure)


def pixels(figure: Figure) -> np.ndarray:
    """Draw a figure as sRGB pixels of 8 bits (height, width, 3)."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _title(name: str, size: tuple[int, int]) -> np.ndarray:
    if not name:
        return np.empty((0, size[0], 3), dtype=np.uint8)
    return caption(name, (size[0], round(_NAME * size[1])))
