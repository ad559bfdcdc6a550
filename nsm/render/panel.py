"""One morph in a film: draws any time, at any angle, always at the same size."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from types import TracebackType

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from nsm.plots.flat import PlaneDrawing
from nsm.plots.look import Look, camera_for, surface
from nsm.plots.studio import Studio, Surface
from nsm.types import Morph

_DPI = 100
#: Height of letters of captions as a share of the height of the caption, and of that of a panel.
_LETTERS, _NAME = 0.45, 0.06


class Panel(ABC):
    """A morph's part of the frames of a film; a context."""

    @abstractmethod
    def draw(self, time: float, angle: float) -> np.ndarray:
        """Pixels (height, width, 3), 8 bits of sRGB, at a time, turned by an angle in radians."""

    def __enter__(self) -> Panel:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    @abstractmethod
    def close(self) -> None:
        """Free what drawing took."""


class SurfacePanel(Panel):
    """A surface, which turns about its vertical axis under a camera and lamps that stand still.

    Args:
        morph: of three dimensions.
        name: its caption; none if empty.
        size: width and height in pixels.
        look: how it is prepared and seen.
        times: that the camera must hold; the whole morph if None.
        turning: whether angles other than 0 will be asked for.
    """

    def __init__(
        self, morph: Morph, name: str, size: tuple[int, int], look: Look, times: Sequence[float] | None, turning: bool
    ) -> None:
        width, height = size
        self._title = _title(name, size)
        height -= len(self._title)
        self._morph, self._look, self._levels = morph, look, look.levels(morph)
        self._camera = camera_for(morph, look, times, height / width, turning)
        self._studio = Studio(self._camera, width)
        self._last: tuple[float, Surface] | None = None

    def draw(self, time: float, angle: float) -> np.ndarray:
        if self._last is None or self._last[0] != time:
            self._last = (time, surface(self._morph, time, self._levels(time), self._look))
        still = self._last[1]
        turned = still._replace(
            vertices=self._camera.turned(still.vertices, angle), normals=still.normals @ self._camera.turn(angle).T
        )
        return np.concatenate([self._title, self._studio.draw(turned)])

    def close(self) -> None:
        self._studio.close()


class PlanePanel(Panel):
    """A shape of the plane; it does not turn.

    Args:
        morph: of two dimensions.
        name: its caption; none if empty.
        size: width and height in pixels.
        look: how it is drawn.
    """

    def __init__(self, morph: Morph, name: str, size: tuple[int, int], look: Look) -> None:
        self._title = _title(name, size)
        self._size = (size[0], size[1] - len(self._title))
        self._drawing = PlaneDrawing(morph, look)

    def draw(self, time: float, angle: float) -> np.ndarray:
        width, height = self._size
        figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
        # the largest box of the drawing's shape, with a margin
        wide = 0.94 * min(width, height / self._drawing.aspect)
        tall = wide * self._drawing.aspect
        axis = figure.add_axes((0.5 - wide / width / 2, 0.5 - tall / height / 2, wide / width, tall / height))
        self._drawing.draw(axis, time, line=0.0035 * wide)
        axis.spines[:].set(color="0.8", linewidth=0.001 * wide)
        return np.concatenate([self._title, pixels(figure)])

    def close(self) -> None:
        """Nothing is held."""


def caption(text: str, size: tuple[int, int]) -> np.ndarray:
    """Pixels (height, width, 3) of a line of text in the middle of white paper; ``size`` is width and height."""
    width, height = size
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    figure.text(0.5, 0.5, text, ha="center", va="center", fontsize=_LETTERS * height * 72 / _DPI, color="0.15")
    return pixels(figure)


def pixels(figure: Figure) -> np.ndarray:
    """A drawn figure as (height, width, 3), 8 bits of sRGB."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _title(name: str, size: tuple[int, int]) -> np.ndarray:
    if not name:
        return np.empty((0, size[0], 3), dtype=np.uint8)
    return caption(name, (size[0], round(_NAME * size[1])))
