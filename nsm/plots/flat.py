"""Drawings of 2D morphs: the inside filled, with level sets of f."""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from matplotlib.axes import Axes

from nsm.geometry.grid import Lattice, evaluate
from nsm.io.palette import INSIDE, OUTLINE
from nsm.plots.colors import clay_colors
from nsm.plots.look import Look
from nsm.types import Morph

#: Number of level sets on either side of the outline, and their distance relative to the box.
_LEVELS, _SPACING = 20, 1 / 24
#: Fills from the outline inwards, and from it outwards.
_INSIDE = (INSIDE, "#B4CFEC", "#98BCE2", "#7CA8D7", "#6496CB", "#5086BF")
_OUTSIDE = ("#FFFFFF", "#FCFCFC", "#FAFAFA", "#F8F8F8", "#F6F6F6", "#F4F4F4")
#: Lines of the level sets inside and outside.
_LINE_INSIDE, _LINE_OUTSIDE = "#6E97C4", "0.80"


class LevelSetDrawing:
    """Draws a 2D morph on axes: the inside filled, a strong outline, and fine level sets of f.

    Args:
        morph: A morph of two dimensions.
        look: Resolution, levels, and colors; clay shades the inside by its depth.

    Attributes:
        aspect: Height of the morph's box divided by its width, which the axes should have.
    """

    def __init__(self, morph: Morph, look: Look) -> None:
        self._morph, self._look, self._levels = morph, look, look.levels(morph)
        lattice = Lattice.corners(morph.bounds, look.resolution)
        ticks = [torch.arange(n, device=morph.bounds.device) for n in lattice.shape]
        self._points = lattice.points(torch.stack(torch.meshgrid(*ticks, indexing="ij"), -1))
        extent = morph.bounds[1] - morph.bounds[0]
        width, height = extent.tolist()
        self.aspect = height / width
        self._spacing = float(extent.max()) * _SPACING

    def draw(self, axis: Axes, time: float, line: float = 1.6) -> None:
        """Draw one time, with an outline that is ``line`` points wide."""
        field = partial(self._morph, t=time)
        values = evaluate(field, self._points.view(-1, 2)).view(self._points.shape[:2]) - self._levels(time)
        heights, place = values.cpu().numpy(), self._points.cpu().unbind(-1)
        steps = self._spacing * np.arange(-_LEVELS, _LEVELS + 1)
        deeper, higher = (
            [shades[min(number, len(shades) - 1)] for number in range(_LEVELS)] for shades in (_INSIDE, _OUTSIDE)
        )
        axis.contourf(*place, heights, levels=steps, colors=[*deeper[::-1], *higher], extend="both")
        if self._look.colors is not clay_colors:
            self._fill(axis, values, time)
        for levels, color in ((steps[steps < 0], _LINE_INSIDE), (steps[steps > 0], _LINE_OUTSIDE)):
            axis.contour(*place, heights, levels=levels, colors=color, linewidths=line / 4, linestyles="-")
        if heights.min() < 0 < heights.max():
            axis.contour(*place, heights, levels=[0.0], colors=[OUTLINE], linewidths=line)
        low, high = self._morph.bounds.cpu().double().numpy()
        axis.set_xlim(low[0], high[0])
        axis.set_ylim(low[1], high[1])
        axis.set_xticks([])
        axis.set_yticks([])

    def _fill(self, axis: Axes, values: torch.Tensor, time: float) -> None:
        """Color the inside of the shape and a narrow band around it, whose rim the outline covers."""
        inside = values < 0.25 * self._spacing
        pixels = np.zeros((*values.shape, 4))
        if bool(inside.any()):
            colors = self._look.colors(self._morph, self._points[inside], time)
            pixels[inside.cpu().numpy()] = np.c_[colors.cpu().double().numpy(), np.ones(len(colors))]
        pixels[..., 3] *= (values < 0).cpu().numpy()
        low, high = self._morph.bounds.cpu().double().numpy()
        extent = (low[0], high[0], low[1], high[1])
        # above the filled contours and below their lines
        axis.imshow(
            pixels.swapaxes(0, 1), extent=extent, origin="lower", interpolation="bilinear", aspect="auto", zorder=1.5
        )
